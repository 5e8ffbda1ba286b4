// An operator records a whole session by the wizard, take by take, and calibrates on it.
// Usage: node record.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { faults, openStation } from "./station.mjs";

const [url, shots] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, errors, button, shot, get, until, step } = station;

const recording = async () => (await get("recording")).session;
const phase = async () => (await recording())?.phase;

await step("the operator takes control and starts a session", async () => {
  await until("ready", station.allReady);
  await page.goto(`${url}/#/record`);
  await station.takeControl("Ada");
  await page.getByText("Record a calibration session").waitFor();
  await shot("record-start");
  await button("Start session").click();
  const session = await until("started", (session) => session?.phase === "place_object", recording);
  assert.equal(session.operator, "Ada");
});

const { session: id, steps } = await recording();
assert.equal(steps.length, 9);

/** Presses a button once the page offers it, until the station has taken it in. */
async function press(name, taken) {
  await until(`${name} taken in`, (done) => done, async () => {
    if (await taken()) return true;
    await button(name).click({ timeout: 3000 }).catch(() => {});
    await page.waitForTimeout(100);
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
        await press("Object is in place", async () => (await phase()) !== "place_object");
        break;
      case "start_pose": {
        await station.arm();
        // The page offers what comes next as its one primary button: first the way to the start, then the motion.
        const ready = page.getByText("Ready to run");
        const name = (await ready.count()) > 0 ? "Run" : "Go to start pose";
        await button(name).click({ timeout: 3000 }).catch(() => {});
        await page.waitForTimeout(300);
        break;
      }
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
          await press("Accept", taken(idx));
        } else {
          retries.push(session.problem || verdict.summary);
          await press("Record again", async () => (await phase()) !== "review");
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
  await button("Give back control").click();
  await until("given back", (state) => state.holder === "" && state.phase === "disarmed");
});

await step("a calibration on it finishes", async () => {
  await button("Calibrate on it").click();
  await button("Start calibration").click();
  const done = (runs) => runs.length > 0 && !["queued", "running"].includes(runs[0].state);
  const [run] = await until("calibrated", done, () => get("calibrations"));
  assert.equal(run.state, "done", JSON.stringify(run));
  assert.equal(run.request.session, id);
  await page.getByText(/onset error/).first().waitFor();
  await shot("record-calibrated");
});

assert.deepEqual(faults(errors), [], "the page logged errors");
await context.close();
