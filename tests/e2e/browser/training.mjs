// An operator starts trainings and a diagnosis from Home: gathers an expert's trials, watches the curves, imitates the expert, and
// ends a training that would go on for hours and the diagnosis that waits for it, both found again after the studio was started
// again, for which this writes the line "restart" and reads the address of the new one. Usage: node training.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { once } from "node:events";
import { join } from "node:path";
import { createInterface } from "node:readline";
import { openBrowser } from "./browser.mjs";

let [url, shots] = process.argv.slice(2);
const { context, page, errors } = await openBrowser();
context.setDefaultTimeout(180_000);
const button = (name) => page.getByRole("button", { name, exact: true });
const field = (name) => page.getByRole("textbox", { name, exact: true });
const shot = (name) => page.screenshot({ path: join(shots, `training-${name}.png`) });
/** What pictures are looked at: a phone, a laptop, a desk. */
const SIZES = [[390, 844], [1280, 800], [1920, 1080]];

async function step(name, run) {
  const start = Date.now();
  try {
    await run();
    console.log(`ok   ${name} (${((Date.now() - start) / 1000).toFixed(1)} s)`);
  } catch (error) {
    await shot("failure");
    console.error(`FAIL ${name}\n${error.stack}\n${errors.join("\n")}`);
    await context.close();
    process.exit(1);
  }
}

const document = async (path) => (await page.request.get(`${url}/api/v1${path}`)).json();

async function until(what, ask) {
  const start = Date.now();
  for (;;) {
    const answer = await ask();
    if (answer) return answer;
    assert.ok(Date.now() - start < 180_000, `never ${what}`);
    await page.waitForTimeout(100);
  }
}

async function choose(words) {
  await page.getByRole("combobox", { name: "What to start" }).click();
  await page.getByRole("option", { name: words, exact: true }).click();
}

/** The page takes a text in with its next frame, and shows what it has then. */
const write = (name, text) =>
  until(`${name} written`, async () => {
    if ((await field(name).inputValue()) !== text) await field(name).fill(text);
    await page.waitForTimeout(300);
    return (await field(name).inputValue()) === text;
  });

const ended = async (id) => (await document(`/jobs/${id}`)).state;

/** Takes a picture at every size. */
async function look(name) {
  for (const [width, height] of SIZES) {
    await page.setViewportSize({ width, height });
    await page.waitForTimeout(1500);
    await shot(`${name}-${width}`);
  }
  await page.setViewportSize({ width: 1280, height: 800 });
  await page.waitForTimeout(500);
}

await step("the form has every training and the blind bench, and this studio can do all of them", async () => {
  await page.goto(`${url}/#/home`);
  await button("Start a job").click();
  await page.waitForURL(/job=new/);
  await page.getByRole("combobox", { name: "What to start" }).click();
  const kinds = await document("/kinds");
  assert.deepEqual(kinds.filter(({ is_available }) => !is_available).map(({ kind }) => kind), ["rollouts"], "there is no station");
  await page.getByRole("option").last().waitFor();
  const words = await page.getByRole("option").allTextContents();
  assert.equal(words.length, 9, words.join(", "));
  await page.keyboard.press("Escape");
});

await step("trials of the expert are gathered, and the curves grow to a point an object", async () => {
  await choose("Gather an expert's trials");
  await write("Trials on each object", "2");
  await button("Start").click();
  await page.waitForURL(/job=gathering-1/);
  await page.getByRole("img", { name: /^Curve success_rate: [\d.]+ at step 10$/ }).waitFor();
  await page.getByRole("img", { name: "Curve trials: 20 at step 10" }).waitFor();
  await until("the gathering is done", async () => (await ended("gathering-1")) === "done");
  const points = (await (await page.request.get(`${url}/api/v1/jobs/gathering-1/metrics`)).text()).trim().split("\n");
  assert.deepEqual(points.map((line) => JSON.parse(line).step), [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]);
  await look("curves");
});

await step("the expert is imitated by what was gathered, which a press fills in", async () => {
  await button("Start a job").click();
  await choose("Imitate an expert");
  await page.getByText("which gathered trials? Give jobs such as gathering-1").waitFor();
  await button("gathering-1").click();
  await write("Updates", "4");
  await look("imitation");
  // The form is longer than the window.
  await page.mouse.move(640, 500);
  await page.mouse.wheel(0, 2000);
  await button("Start").click();
  await page.waitForURL(/job=imitation-1/);
  await page.getByRole("img", { name: /^Curve loss: [\d.]+ at step 4$/ }).waitFor();
  await until("the imitation is done", async () => (await ended("imitation-1")) === "done");
  const { spec } = await document("/jobs/imitation-1");
  assert.deepEqual(spec.request, { trials: ["gathering-1"], preset: "small", updates: 4 });
  assert.equal(Object.keys(spec.inputs).length, 10, "every file that it learns from is known by its hash");
});

await step("the policy is traced back to the trials that it imitates", async () => {
  await button("Models").click();
  await button("Policy imitation-1").click();
  await button("Job imitation-1").waitFor();
  await look("models");
  await button("Demonstrations gathering-1").last().click();
  await page.waitForURL(/artifact=demonstrations:gathering-1/);
  // In the list, and in what was made of the trials.
  await until("both", async () => (await button("Policy imitation-1").count()) === 2);
  await button("Jobs").click();
});

await step("a training that would go on for hours is cancelled", async () => {
  await button("Start a job").click();
  await choose("Tune a script");
  // Until it is there, the button is where the form of the kind before has it.
  await page.getByText("Makes a closing script better").waitFor();
  await button("Start").click();
  await page.waitForURL(/job=tuning-1/);
  await until("the tuning works", async () => (await document("/jobs/tuning-1")).fraction > 0);
  await button("Cancel").click();
  await until("the tuning is cancelled", async () => (await ended("tuning-1")) === "cancelled");
  await button("Try again").waitFor();
  await shot("cancelled");
});

await step("a session is calibrated from Home, which then offers to diagnose it", async () => {
  const asked = { kind: "emulate", request: { truth: "demo", session: "demo" } };
  const { id } = await (await page.request.post(`${url}/api/v1/jobs`, { data: asked })).json();
  await until("the session", async () => (await ended(id)) === "done");
  await page.goto(`${url}/#/home`);
  await button("Calibrate on demo").click();
  await page.waitForURL(/#\/calibrate\/demo/);
  const [{ id: run }] = await until("the calibration", async () => {
    const runs = await document("/calibrations");
    return runs.length > 0 && runs[0].state === "done" && runs;
  });
  const saved = await page.request.post(`${url}/api/v1/calibrations/${run}/save`, { data: { name: "Demo hand" } });
  assert.equal(saved.status(), 201, await saved.text());
  await page.goto(`${url}/#/home`);
  await button("Diagnose demo").waitFor();
});

await step("tried again it works on while the studio is started again, and is found there with what waits for it", async () => {
  await page.goto(`${url}/#/jobs?job=tuning-1`);
  await button("Try again").click();
  await until("it works again", async () => {
    const { state, attempts, fraction } = await document("/jobs/tuning-1");
    return state === "running" && attempts === 2 && fraction > 0;
  });
  await page.goto(`${url}/#/home`);
  await button("Diagnose demo").click();
  await page.waitForURL(/run=diagnosis-1/);
  assert.equal((await document("/diagnoses"))[0].state, "queued", "it needs the cores that the tuning has");
  await page.goto(`${url}/#/home`);
  await page.getByRole("button", { name: "diagnosis-1: diagnose waits for its turn" }).waitFor();
  await look("home");
  await page.goto("about:blank");
  console.log("restart");
  const answers = createInterface({ input: process.stdin });
  [url] = await once(answers, "line");
  answers.close();
  await page.goto(`${url}/#/jobs?job=gathering-1`);
  await page.getByRole("img", { name: "Curve trials: 20 at step 10" }).waitFor();
  await page.goto(`${url}/#/jobs?job=tuning-1`);
  await button("Cancel").waitFor();
  const { state, attempts } = await document("/jobs/tuning-1");
  assert.deepEqual([state, attempts], ["running", 2], "it went on");
  await button("Cancel").click();
  await until("the tuning is cancelled", async () => (await ended("tuning-1")) === "cancelled");
  await page.goto(`${url}/#/home`);
  await page.getByRole("button", { name: /^diagnosis-1: diagnose \d+ %/ }).click();
  await until("the diagnosis works", async () => (await ended("diagnosis-1")) === "running");
  await button("Cancel").click();
  await until("the diagnosis is cancelled", async () => (await ended("diagnosis-1")) === "cancelled");
  await button("Try again").click();
  await until("the diagnosis works again", async () => (await document("/jobs/diagnosis-1")).attempts === 2);
  await until("it has begun", async () => (await document("/jobs/diagnosis-1")).fraction > 0);
  await button("Cancel").click();
  await until("the diagnosis is cancelled again", async () => (await ended("diagnosis-1")) === "cancelled");
});

assert.deepEqual(errors, [], "the page logged errors");
await context.close();
