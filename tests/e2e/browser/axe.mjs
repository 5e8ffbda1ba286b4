// axe-core looks at the accessible mirror of every screen, and finds nothing serious.
// Usage: node axe.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { openBrowser } from "./browser.mjs";

const [url, shots] = process.argv.slice(2);
const axeSource = readFileSync(fileURLToPath(import.meta.resolve("axe-core/axe.min.js")), "utf8");

/** Colours are painted on the canvas, where axe sees none: a unit test of the page's theme computes their contrast. */
const RULES = { "color-contrast": { enabled: false } };
const SERIOUS = new Set(["serious", "critical"]);

/** A finished calibration makes Calibrate and Timelines worth looking at. */
async function calibrate() {
  const post = { method: "POST", headers: { "content-type": "application/json" }, body: '{"session":"demo"}' };
  const answer = await fetch(`${url}/api/v1/calibrations`, post);
  assert.equal(answer.status, 202, await answer.clone().text());
  const { id } = await answer.json();
  for (;;) {
    const run = await (await fetch(`${url}/api/v1/calibrations/${id}`)).json();
    if (run.state === "done") return id;
    assert.ok(run.state === "queued" || run.state === "running", JSON.stringify(run));
    await new Promise((resolve) => setTimeout(resolve, 500));
  }
}

const run = await calibrate();
const take = "demo?take=take-01&t=12.4";
const screens = {
  home: "#/home",
  hand: `#/hand/${take}`,
  "hand, live": "#/hand?source=live",
  record: "#/record",
  timelines: `#/timelines/${take}&model=run:${run}`,
  "timelines, live": "#/timelines?source=live",
  calibrate: "#/calibrate/demo",
  "calibrate, result": `#/calibrate/demo?run=${run}`,
  diagnose: "#/diagnose/demo",
  sessions: "#/sessions/demo",
  "sessions, dead link": "#/sessions/nowhere",
  objects: "#/objects",
  plans: "#/plans",
  models: "#/models",
  trials: "#/trials",
  jobs: "#/jobs",
  people: "#/settings?part=people",
  tokens: "#/settings?part=tokens",
  storage: "#/settings?part=storage",
  "audit log": "#/settings?part=audit",
  help: "#/help",
  "help, a document": "#/help/recordings",
  "no screen": "#/bananas",
};

/** Screens whose elements are others on a phone. */
const NARROW = new Set(["home", "hand, live", "record", "timelines", "diagnose", "trials", "help, a document"]);

const found = [];

/** What axe finds on `page` now; `place` says where that was. */
async function look(page, place) {
  await page.waitForFunction(() => document.querySelectorAll("#mirror > *").length > 5);
  await page.waitForTimeout(800);
  // Not a script of the page, which would have to come from the studio.
  await page.evaluate(axeSource);
  const { violations } = await page.evaluate((rules) => globalThis.axe.run(document, { rules }), RULES);
  for (const { id, impact, help, nodes } of violations) {
    const line = `${place}: ${impact}: ${id}: ${help}: ${nodes.slice(0, 3).map((node) => node.html).join(" ")}`;
    console.log(line.slice(0, 1200));
    if (SERIOUS.has(impact)) found.push(line);
  }
  console.log(`ok   axe has looked at ${place}`);
}

for (const [size, width] of [["wide", 1280], ["narrow", 390]]) {
  const { context, page, errors } = await openBrowser({ width, height: 844 });
  const button = (name) => page.getByRole("button", { name, exact: true });
  const shown = Object.entries(screens).filter(([name]) => size === "wide" || NARROW.has(name));
  for (const [name, hash] of shown) {
    await page.goto(`${url}/${hash}`);
    await page.waitForFunction(() => !document.getElementById("skeleton"));
    await look(page, `${name} (${size})`);
  }
  await page.goto(`${url}/#/calibrate/demo`);
  await button("Sessions").waitFor();
  await page.keyboard.press("Control+k");
  await page.getByRole("textbox", { name: "Command" }).waitFor();
  await look(page, `palette (${size})`);
  await page.keyboard.press("Escape");
  // What is typed before it has closed goes into its field.
  await page.getByRole("textbox", { name: "Command" }).waitFor({ state: "detached" });
  await page.keyboard.press("?");
  await button("Close shortcuts").waitFor();
  await look(page, `shortcuts (${size})`);
  await button("Close shortcuts").click();
  await page.goto(`${url}/#/timelines/${take}`);
  await page.getByRole("combobox", { name: "Speed", exact: true }).click();
  await page.getByRole("option", { name: "2\u00d7", exact: true }).waitFor();
  await look(page, `open list (${size})`);
  await page.screenshot({ path: join(shots, `axe-${width}.png`) });
  assert.deepEqual(errors, [], "the page logged errors");
  await context.close();
}

assert.deepEqual(found, [], "axe found what keeps people from using the page");
