// An operator diagnoses the demonstration session, watches the gap shrink, adds what was named, and takes it out again.
// Usage: node diagnose.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { join } from "node:path";
import { byKeyboard, openBrowser } from "./browser.mjs";

const [url, shots] = process.argv.slice(2);
const { context, page, errors } = await openBrowser();
page.setDefaultTimeout(300_000);
const button = (name) => page.getByRole("button", { name, exact: true });
const shot = (name) => page.screenshot({ path: join(shots, `${name}.png`) });
const get = async (path) => (await page.request.get(`${url}/api/v1${path}`)).json();

async function step(name, run) {
  try {
    await run();
    console.log(`ok   ${name}`);
  } catch (error) {
    await shot("diagnose-failure");
    console.error(`FAIL ${name}\n${error.stack}\n${errors.join("\n")}`);
    await context.close();
    process.exit(1);
  }
}

/** What a button says may differ; what the server knows is what counts. */
async function until(what, condition) {
  for (let i = 0; i < 600; i++) {
    if (await condition()) return;
    await page.waitForTimeout(100);
  }
  throw new Error(`${what} did not come`);
}

// The operator starts from a saved model, so that there is one to add to.
const calibration = await (
  await page.request.post(`${url}/api/v1/calibrations`, { data: { session: "demo" } })
).json();
await until("the calibration", async () => (await get(`/calibrations/${calibration.id}`)).state === "done");
const saved = await page.request.post(`${url}/api/v1/calibrations/${calibration.id}/save`, {
  data: { name: "Demo hand" },
});
const model = (await saved.json()).id;
const modelText = async () => (await page.request.get(`${url}/api/v1/models/${model}`)).text();
const before = await modelText();
let run;

await step("one button diagnoses the session from the saved model", async () => {
  await page.goto(`${url}/#/diagnose/demo`);
  await page.getByRole("combobox", { name: "Start from" }).click();
  await page.getByRole("option", { name: "Demo hand" }).click();
  await byKeyboard(page, "button", "Start diagnosis");
  await button("Cancel").waitFor();
  await shot("diagnose-running");
  await page.getByText(/^(EXPLAINED|PARTLY EXPLAINED)$/).waitFor();
  run = (await get("/diagnoses"))[0];
  assert.equal(run.state, "done");
  assert.equal(run.request.model, model);
  assert.match(await page.evaluate(() => location.hash), /^#\/diagnose\/demo.*run=diagnosis-/);
  await page.waitForTimeout(1000);
  await shot("diagnose");
});

await step("the gap shrinks on takes that nothing was fitted to, and the page says so", async () => {
  const { report } = await get(`/diagnoses/${run.id}`);
  assert.ok(report.effects.length > 0, report.sentence);
  assert.ok(report.held_out.diagnosed < 0.45 * report.held_out.calibrated, JSON.stringify(report.held_out));
  // What is strongest in the demonstration's world: both streams are late.
  const late = report.effects.filter((effect) => effect.id === "latency").map((effect) => effect.where.stream);
  assert.deepEqual(late.sort(), ["fsr", "twintac"], report.effects.map((effect) => effect.explanation).join(" "));
  const steps = report.waterfall.map((known) => known.step);
  assert.deepEqual(steps.slice(0, 2), ["nominal", "calibrated"]);
  for (const effect of report.effects) {
    const sentence = effect.explanation.replace(/\.$/, "");
    assert.ok((await page.getByText(sentence).count()) > 0, `the page does not say: ${sentence}`);
  }
});

await step("evidence is one click away", async () => {
  // With the keyboard also what was out of sight is brought into view.
  await byKeyboard(page, "button", /^Evidence for /);
  await page.getByText(/the bar is /).first().waitFor();
});

await step("adding changes the model's file and makes it the model in use", async () => {
  await byKeyboard(page, "button", `Add to ${model}`);
  await page.getByText(new RegExp(`Added to ${model}`)).waitFor();
  const after = await modelText();
  assert.notEqual(after, before);
  assert.match(after, /\[\[effect\]\]/);
  const summary = (await get("/models")).find((known) => known.id === model);
  assert.equal(summary.earlier_versions, 1);
  assert.ok(summary.effects.length > 0);
  await shot("diagnose-added");
});

await step("Timelines shows real, before and after", async () => {
  await button("Timelines").first().click();
  await page.getByRole("img", { name: "FSR, any" }).waitFor();
  assert.match(await page.evaluate(() => location.hash), new RegExp(`diagnosed=${model}`));
  await page.waitForTimeout(1500);
  await shot("timelines-diagnosed");
  await page.goBack();
});

await step("undo brings the file back byte for byte", async () => {
  await byKeyboard(page, "button", "Undo");
  await button(`Add to ${model}`).waitFor();
  assert.equal(await modelText(), before);
});

await step("the residual map goes onto the hand", async () => {
  // What is out of sight on the canvas cannot be clicked: a window that is tall enough shows all of it.
  await page.setViewportSize({ width: 1280, height: 4000 });
  await until("the button on the screen", async () => (await button("Show on the hand").boundingBox())?.y > 60);
  await button("Show on the hand").click({ timeout: 30_000 });
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.getByText("Mismatch").first().waitFor();
  await page.waitForTimeout(1500);
  await shot("hand-mismatch");
});

assert.deepEqual(errors, [], "the page logged errors");
await context.close();
