// Two people with logins of their own: a viewer sees everything and is refused whatever starts, changes or deletes something; an
// operator may do that, and manages no people. Usage: node people.mjs URL SCREENSHOT_DIR
// People are those of `people_may_what_their_role_says` in tests/e2e/tests/it/page.rs.
import assert from "node:assert/strict";
import { join } from "node:path";
import { launchBrowser, openContext, request } from "./browser.mjs";

const [url, shots] = process.argv.slice(2);
const browser = await launchBrowser();
const viewer = await openContext(browser);
const operator = await openContext(browser);

const button = (name, on) => on.page.getByRole("button", { name, exact: true });
const says = (text, on) => on.page.getByText(text).first();
const shot = (name, on) => on.page.screenshot({ path: join(shots, `people-${name}.png`) });
const isDisabled = async (locator) => (await locator.getAttribute("aria-disabled")) === "true";

async function step(name, run) {
  try {
    await run();
    console.log(`ok   ${name}`);
  } catch (error) {
    for (const [who, on] of Object.entries({ viewer, operator })) await shot(`failure-${who}`, on).catch(() => {});
    console.error(`FAIL ${name}\n${error.stack}\n${[...viewer.errors, ...operator.errors].join("\n")}`);
    await browser.close();
    process.exit(1);
  }
}

const document = async (path, on) => JSON.parse((await request(on, "GET", path)).text);

async function fillIn(on, name, password) {
  await on.page.getByLabel("Name").fill(name);
  await on.page.getByLabel("Password").fill(password);
  await on.page.getByRole("button", { name: "Log in" }).click();
}

await step("nobody gets in without a login, or with a wrong password", async () => {
  await viewer.page.goto(`${url}/#/jobs`);
  await viewer.page.getByLabel("Password").waitFor();
  const answer = await viewer.page.request.get(`${url}/api/v1/sessions`);
  assert.equal(answer.status(), 401);
  await fillIn(viewer, "vera", "a password of olga");
  await viewer.page.getByRole("alert").waitFor();
  assert.equal(await viewer.page.getByLabel("Name").inputValue(), "vera");
  await shot("refused", viewer);
});

await step("both log in", async () => {
  await fillIn(viewer, "vera", "a password of vera");
  await button("Sessions", viewer).waitFor();
  await operator.page.goto(url);
  await fillIn(operator, "olga", "a password of olga");
  await button("Sessions", operator).waitFor();
});

await step("a viewer is told why no training starts", async () => {
  await button("Jobs", viewer).click();
  await button("Start a job", viewer).click();
  await says(/^You are vera \(viewer\): you can watch\. Operators start and end jobs/, viewer).waitFor();
  assert.ok(await isDisabled(button("Start", viewer)), "a viewer can start a training");
  await shot("viewer-training", viewer);
});

await step("a viewer looks at a session and cannot calibrate on it", async () => {
  await button("Calibrate", viewer).click();
  const start = button("Start calibration", viewer);
  await start.waitFor();
  await says("Operators start and end jobs", viewer).waitFor();
  assert.ok(await isDisabled(start), "a viewer can calibrate");
});

await step("what a viewer's page asks for all the same is refused, and changes nothing", async () => {
  for (const asked of [
    ["POST", "/jobs", { kind: "calibrate", request: { session: "demo" } }],
    ["POST", "/calibrations", { session: "demo" }],
    ["DELETE", "/sessions/demo"],
    ["POST", "/people", { name: "mallory", role: "admin", password: "a password of mallory" }],
    ["PATCH", "/people/vera", { role: "admin" }],
    ["DELETE", "/people/olga"],
  ]) {
    const answer = await request(viewer, ...asked);
    assert.equal(answer.status, 403, `${asked.join(" ")}: ${answer.text}`);
    assert.match(JSON.parse(answer.text).detail, /viewer/, answer.text);
  }
  assert.deepEqual((await document("/jobs", viewer)).jobs, []);
  assert.deepEqual((await document("/sessions", viewer)).map(({ id }) => id), ["demo"]);
  assert.equal((await document("/me", viewer)).role, "viewer");
});

await step("an operator calibrates, and the viewer sees the job without a button that ends it", async () => {
  await button("Calibrate", operator).click();
  await button("Start calibration", operator).click();
  await says(/^Calibrated: onset error from/, operator).waitFor();
  await button("Jobs", viewer).click();
  await viewer.page.getByRole("button", { name: /^Job run-1: calibrate done$/ }).click();
  await says("Operators start and end jobs", viewer).waitFor();
  for (const name of ["Delete", "Run the same anew", "Cancel"]) assert.equal(await button(name, viewer).count(), 0, name);
  assert.equal((await document("/jobs", viewer)).jobs[0].owner, "olga");
  await shot("viewer-job", viewer);
});

await step("an operator manages no people", async () => {
  await button("Settings", operator).click();
  await says(/^People are managed by admins\. Your role is operator/, operator).waitFor();
  const person = { name: "mallory", role: "admin", password: "a password of mallory" };
  assert.equal((await request(operator, "POST", "/people", person)).status, 403);
  await shot("operator-settings", operator);
});

await step("who logs out is out", async () => {
  await button("Settings", viewer).click();
  await viewer.page.getByRole("link", { name: "Log out" }).click();
  const { page } = viewer;
  await page.waitForURL(`${url}/logout`);
  await page.getByText("You are vera (viewer).").waitFor();
  await page.getByRole("button", { name: "Log out" }).click();
  await page.getByLabel("Password").waitFor();
  const answer = await viewer.page.request.get(`${url}/api/v1/sessions`);
  assert.equal(answer.status(), 401);
});

// A refusal is an error of the network to the browser, and was asked for here.
const unexpected = [...viewer.errors, ...operator.errors].filter((error) => !/status of (401|403)/.test(error));
assert.deepEqual(unexpected, [], "the pages logged errors");
await browser.close();
