// An operator takes control of the emulated station, moves a finger, stops and resets; somebody else can only watch.
// Usage: node operate.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { openPage } from "./browser.mjs";
import { disabled, faults, openStation } from "./station.mjs";

const [url, shots] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, errors, button, shot, live, until, step } = station;

const JOINT = "index_mcp_forward";
const armed = page.getByText("ARMED", { exact: true });
const slider = (on = page) => on.getByRole("slider", { name: JOINT, exact: true });

await step("the page says that the station is emulated and that nobody commands it", async () => {
  await until("ready", station.allReady);
  await page.goto(`${url}/#/hand`);
  await button("Live").click();
  await page.getByText(/LIVE \(EMULATED\)/).first().waitFor();
  await page.getByText("Nobody has control").waitFor();
  await slider().waitFor();
  assert.ok(await slider().isDisabled(), "a slider can be moved without control");
  assert.equal((await live()).holder, "");
});

await step("the operator takes control and arms", async () => {
  await station.takeControl("Ada");
  // The page hears by its socket, everybody else by the next published state.
  await until("held by Ada", (state) => state.holder === "Ada");
  await until("shown as armed", async () => {
    await station.arm();
    return armed.isVisible();
  });
});

await step("a finger follows its slider, moved by keys", async () => {
  const before = (await live()).joints[JOINT];
  const follows = (state) =>
    state.joints[JOINT] > before + 0.1 && Math.abs(state.joints[JOINT] - state.commanded[JOINT]) < 0.03;
  const pressRight = async () => {
    await slider().focus();
    for (let press = 0; press < 4; press += 1) await page.keyboard.press("ArrowRight");
  };
  await station.whileArmed("moved", pressRight, follows);
  const after = (await live()).joints[JOINT];
  console.log(`     ${JOINT} went from ${before.toFixed(3)} to ${after.toFixed(3)} rad`);
  await shot("operate-armed");
});

const watching = await openPage(context);

await step("a second page sees who commands, and cannot", async () => {
  await watching.page.goto(`${url}/#/hand`);
  await button("Live", watching.page).click();
  await watching.page.getByText("Ada has control").waitFor();
  await slider(watching.page).waitFor();
  assert.ok(await slider(watching.page).isDisabled(), "a watcher's slider moves");
  await button("Open hand", watching.page).waitFor();
  assert.ok(await disabled(button("Open hand", watching.page)), "a watcher can open the hand");
  const armOrNot = watching.page.getByRole("button", { name: /^(Arm|Disarm)$/ });
  assert.ok(await disabled(armOrNot), "a watcher can arm or disarm");
  await shot("operate-watching", watching.page);
  assert.equal((await live()).holder, "Ada");
});

await step("the space bar stops, and the stop is confirmed and latched", async () => {
  await page.bringToFront();
  const pressSpace = async () => {
    // It is for playing until the page knows that the station is armed.
    if (await armed.isVisible()) await page.keyboard.press("Space");
  };
  await station.whileArmed("stopped", pressSpace, (state) => state.phase === "stopped");
  await until("confirmed", (state) => state.phase === "stopped" && state.stop_confirmed);
  await page.getByText("STOPPED", { exact: true }).first().waitFor();
  await shot("operate-stopped");
  assert.ok(await slider().isDisabled(), "a slider moves a stopped station");
  assert.equal(await button("Arm").count(), 0, "a stopped station can be armed");
});

await step("reset ends the stop, disarmed; the station can be armed again and control given back", async () => {
  await button("Reset stop").click();
  await until("disarmed", (state) => state.phase === "disarmed");
  await station.arm();
  await button("Give back control").click();
  await until("given back", (state) => state.holder === "" && state.phase === "disarmed");
  await watching.page.getByText("Nobody has control").waitFor();
});

await step("a page that loses its graphics loads itself again, where it was", async () => {
  const address = page.url();
  await page.waitForFunction(() => performance.now() > 10_000);
  const loaded = page.waitForEvent("load");
  await page.evaluate(() => {
    document.getElementById("palpate").getContext("webgl2").getExtension("WEBGL_lose_context").loseContext();
  });
  await loaded;
  await page.getByText("Nobody has control").waitFor();
  assert.equal(page.url(), address);
});

assert.deepEqual(faults([...errors, ...watching.errors]), [], "the pages logged errors");
await context.close();
