// An operator opens every screen, calibrates by clicking, and sees the metrics improve.
// Usage: node studio.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { openBrowser } from "./browser.mjs";

const [url, shots] = process.argv.slice(2);
const { context, page, errors } = await openBrowser();
await page.addInitScript(() => {
  // What the browser compiles: boot.js passes shaders on to here.
  const { shaderSource } = WebGL2RenderingContext.prototype;
  window.shaders = [];
  WebGL2RenderingContext.prototype.shaderSource = function (shader, source) {
    window.shaders.push(source);
    shaderSource.call(this, shader, source);
  };
});
const button = (name) => page.getByRole("button", { name, exact: true });
const shot = (name) => page.screenshot({ path: join(shots, `${name}.png`) });

async function step(name, run) {
  try {
    await run();
    console.log(`ok   ${name}`);
  } catch (error) {
    await shot("failure");
    console.error(`FAIL ${name}\n${error.stack}\n${errors.join("\n")}`);
    await context.close();
    process.exit(1);
  }
}

/** The address bar follows what is on the screen. */
const hash = () => page.evaluate(() => location.hash);

/** The file that the browser keeps when `press` is done. */
async function kept(press) {
  const [download] = await Promise.all([page.waitForEvent("download"), press()]);
  return { name: download.suggestedFilename(), bytes: await readFile(await download.path()) };
}

await step("the page starts and names its screens", async () => {
  await page.goto(url);
  // Record is there once the live station is: until then the rail may still move under a click.
  for (const screen of ["Home", "Hand", "Record", "Timelines", "Calibrate", "Sessions", "Settings"]) {
    await button(screen).waitFor();
  }
});

await step("shaders are without the slow way to filter textures", async () => {
  const shaders = await page.evaluate(() => window.shaders);
  assert.ok(shaders.some((source) => source.includes("predictable_texture_filtering")), "egui calls it otherwise now");
  assert.ok(!shaders.some((source) => /\.predictable_texture_filtering/.test(source)), "boot.js does not replace it");
});

await step("Home is first, and its button would calibrate the ready session", async () => {
  for (const card of ["What next", "Station", "What runs", "Sensor models"]) {
    await page.getByRole("heading", { name: card, exact: true }).waitFor();
  }
  await button("Calibrate on demo").waitFor();
  await shot("home");
});

await step("Sessions shows the ready session, checked and covered", async () => {
  await button("Sessions").click();
  await button("Session demo").click();
  await page.getByText(/44 of 44 channels touched at least 4 times in each half/).waitFor();
  assert.match(await hash(), /^#\/sessions\/demo/);
  await shot("sessions");
});

await step("A session and a take are downloaded", async () => {
  const link = (name) => page.getByRole("link", { name, exact: true });
  const session = await kept(() => link("Download session").click());
  assert.equal(session.name, "demo.zip");
  assert.equal(session.bytes.subarray(0, 2).toString(), "PK");
  const take = await kept(() => link("Download take-01").click());
  assert.equal(take.name, "demo-take-01.mcap");
  assert.equal(take.bytes.subarray(1, 5).toString(), "MCAP");
  assert.match(await hash(), /^#\/sessions\/demo/, "the page stays");
});

await step("Hand replays a take", async () => {
  await button("Watch on the hand").click();
  await button("Play").waitFor();
  await page.waitForTimeout(1000);
  await shot("hand");
  await button("Play").click();
  await page.waitForFunction(() => Number(new URLSearchParams(location.hash.split("?")[1]).get("t")) >= 0);
  await page.waitForTimeout(1500);
  await page.keyboard.press("Escape");
  await button("Pause").click();
  await page.waitForTimeout(1000);
  const seconds = Number(new URLSearchParams((await hash()).split("?")[1]).get("t"));
  assert.ok(seconds > 0.2, `the cursor stands at ${seconds} s after playing`);
});

await step("Timelines shows real and nominal events", async () => {
  await button("Timelines").click();
  await page.getByRole("img", { name: "FSR, any" }).waitFor();
  await page.getByRole("img", { name: "TwinTac, any" }).waitFor();
  const before = await hash();
  await page.keyboard.press("]");
  await page.waitForFunction((old) => location.hash !== old, before);
  await shot("timelines-nominal");
  const picture = await kept(() => button("Save picture").click());
  assert.match(picture.name, /^timelines-demo-take-\d+\.png$/);
  assert.equal(picture.bytes.subarray(1, 4).toString(), "PNG");
  // One colour all over would be far smaller.
  assert.ok(picture.bytes.length > 10_000, `${picture.bytes.length} bytes`);
  await writeFile(join(shots, "kept.png"), picture.bytes);
});

await step("Calibrate improves onset error, F1 and false positives on held-out takes", async () => {
  await button("Calibrate").click();
  await button("Start calibration").click();
  const headline = page.getByText(/^Calibrated: onset error from/);
  await headline.waitFor();
  const text = (await headline.textContent()) || (await headline.getAttribute("aria-label"));
  const numbers = [...text.matchAll(/from ([\d.]+) to ([\d.]+)/g)].map((match) => match.slice(1, 3).map(Number));
  assert.equal(numbers.length, 3, text);
  const [onset, f1, fpr] = numbers;
  assert.ok(onset[1] < onset[0], text);
  assert.ok(f1[1] > f1[0], text);
  assert.ok(fpr[1] < fpr[0], text);
  await page.waitForTimeout(500);
  await shot("calibrate");
});

await step("the model is saved and stays", async () => {
  await button("Save model").click();
  await page.getByText(/Saved as /).waitFor();
  const models = await (await page.request.get(`${url}/api/v1/models`)).json();
  assert.equal(models.length, 1);
  await shot("calibrate-saved");
});

await step("Timelines shows the calibrated events below", async () => {
  await button("Compare on Timelines").click();
  await page.getByRole("img", { name: "FSR, any" }).waitFor();
  await page.waitForTimeout(1500);
  await shot("timelines-calibrated");
});

await step("back leads back, shortcuts are listed", async () => {
  await page.goBack();
  await button("Start calibration").waitFor();
  await page.keyboard.press("?");
  await page.getByText("Next mismatch").waitFor();
  await shot("shortcuts");
  await page.keyboard.press("Escape");
});

await step("the live station is on the hand", async () => {
  await button("Hand").click();
  await button("Live").click();
  await page.getByText(/LIVE/).first().waitFor();
  await page.waitForTimeout(1500);
  await shot("hand-live");
});

await step("Home has gone on to the diagnosis, with the model that was saved", async () => {
  await button("Home").click();
  await button("Diagnose demo").waitFor();
});

await step("Settings says that there is no login, and its audit log has the calibration", async () => {
  await button("Settings").click();
  await page.getByText(/^There is no login/).waitFor();
  await page.getByRole("tab", { name: "Audit log", exact: true }).click();
  await page.getByText(/calibrations/).first().waitFor();
  assert.match(await hash(), /^#\/settings\?.*part=audit/);
  await shot("settings-audit");
});

assert.deepEqual(errors, [], "the page logged errors");
await context.close();
