// An operator records a whole session by the wizard, take by take, and calibrates on it, with the keyboard alone.
// Usage: node record.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { byKeyboard } from "./browser.mjs";
import { faults, openStation } from "./station.mjs";

const [url, shots] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, errors, shot, get, until, step } = station;

const recording = async () => (await get("recording")).session;
const phase = async () => (await recording())?.phase;

await step("the operator takes control and starts a session", async () => {
  await until("ready", station.allReady);
  await page.goto(`${url}/#/record`);
  await byKeyboard(page, "button", "Take control");
  await page.getByRole("textbox", { name: "Your name" }).waitFor();
  // The field has the focus as soon as it is there.
  await page.waitForTimeout(500);
  await page.keyboard.type("Ada", { delay: 60 });
  await page.keyboard.press("Enter");
  await page.getByText("You have control").waitFor();
  await page.getByText("Record a calibration session").waitFor();
  await shot("record-start");
  await byKeyboard(page, "button", "Start session");
  const session = await until("started", (session) => session?.phase === "place_object", recording);
  assert.equal(session.operator, "Ada");
});

const { session: id, steps } = await recording();
assert.equal(steps.length, 4);

/** Presses a key until the station has taken in what it does. */
async function press(key, taken) {
  await until(`${key} taken in`, (done) => done, async () => {
    if (await taken()) return true;
    // A button that has the focus would take the key for itself.
    await page.keyboard.press("Escape");
    await page.keyboard.press(key);
    await page.waitForTimeout(300);
    return taken();
  });
}

const taken = (idx) => async () => (await recording()).steps[idx].state === "accepted";

/** A take lasts half a minute; on a machine that is too slow for the station it may need several. */
const TAKE_PATIENCE_MS = 400_000;

/** Leads one take through the phases; where the machine was too slow for the station, the take is recorded again. */
async function recordTake(idx) {
  const retries = [];
  let pictured = false;
  await until(`take ${idx + 1} accepted`, (done) => done, async () => {
    const session = await recording();
    if (session.steps[idx].state === "accepted") return true;
    switch (session.phase) {
      case "place_object":
        await press("Enter", async () => (await phase()) !== "place_object");
        break;
      case "start_pose":
        if ((await station.live()).phase === "disarmed") {
          await byKeyboard(page, "button", "Arm");
          await page.waitForTimeout(300);
        } else {
          // First the way to the start, then the motion.
          await page.keyboard.press((await page.getByText("Ready to run").count()) > 0 ? "b" : "g");
          await page.waitForTimeout(300);
        }
        break;
      case "running":
        if (idx === 0 && !pictured) {
          pictured = true;
          await page.waitForTimeout(2000);
          await shot("record-running");
        }
        break;
      case "review": {
        const { verdict } = session.steps[idx];
        if (verdict === null) break;
        if (idx === 0) await shot("record-review");
        if (session.problem === "" && verdict.covered.length > 0) {
          // What is bad is recorded again by Enter; this session takes it as it is.
          await press(verdict.good ? "Enter" : "a", taken(idx));
        } else {
          retries.push(session.problem || verdict.summary);
          await press("r", async () => (await phase()) !== "review");
        }
        break;
      }
    }
    await page.waitForTimeout(200);
    return taken(idx)();
  }, TAKE_PATIENCE_MS);
  const { verdict } = (await recording()).steps[idx];
  console.log(`     ${verdict.good ? "good" : "not so good"}: ${verdict.summary}`);
  for (const why of retries) console.log(`     recorded again: ${why}`);
}

for (const [idx, { object_label, touches }] of steps.entries()) {
  await step(`take ${idx + 1} of ${steps.length}: ${object_label}, ${touches.length} channels`, () => recordTake(idx));
}

await step("every take is part of the session, and the session is in order", async () => {
  await until("done", (now) => now === "done", phase);
  await page.getByText("Every take is recorded").waitFor();
  await shot("record-done");
  const listed = (await get("sessions")).find((session) => session.id === id);
  assert.equal(listed.takes, steps.length, JSON.stringify(listed));
  const check = await get(`sessions/${id}/check`);
  assert.equal(check.ok, true, JSON.stringify(check));
  await byKeyboard(page, "button", "Give back control");
  await until("given back", (state) => state.holder === "" && state.phase === "disarmed");
});

await step("a calibration on it finishes", async () => {
  await byKeyboard(page, "button", "Calibrate on it");
  await byKeyboard(page, "button", "Start calibration");
  const done = (runs) => runs.length > 0 && !["queued", "running"].includes(runs[0].state);
  const [run] = await until("calibrated", done, () => get("calibrations"));
  assert.equal(run.state, "done", JSON.stringify(run));
  assert.equal(run.request.session, id);
  await page.getByText(/onset error/).first().waitFor();
  await shot("record-calibrated");
});

assert.deepEqual(faults(errors), [], "the page logged errors");
await context.close();
