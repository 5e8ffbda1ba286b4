// Takes a picture of every screen at the sizes people have, in both themes.
// Usage: node screenshots.mjs URL OUT_DIR [SESSION]
import { join } from "node:path";
import { openBrowser } from "./browser.mjs";

const [url, out, session = "demo"] = process.argv.slice(2);
const screens = {
  home: "#/home",
  hand: `#/hand/${session}?take=take-01&t=12.4`,
  timelines: `#/timelines/${session}?take=take-01&t=12.4`,
  calibrate: `#/calibrate/${session}`,
  diagnose: `#/diagnose/${session}`,
  sessions: `#/sessions/${session}`,
  trials: "#/trials",
  jobs: "#/jobs",
  job_form: "#/jobs?job=new",
  models: "#/models",
  objects: "#/objects",
  plans: "#/plans",
  record: "#/record",
  settings: "#/settings?part=audit",
  help: "#/help/learning",
};

// A finished run makes Calibrate and Timelines worth looking at.
const runs = await (await fetch(`${url}/api/v1/calibrations`)).json();
const run = runs.find((known) => known.state === "done" && known.request.session === session);
if (run) {
  screens.calibrate += `?run=${run.id}`;
  screens.timelines += `&model=run:${run.id}`;
}

const diagnoses = await (await fetch(`${url}/api/v1/diagnoses`)).json();
const diagnosis = diagnoses.find((known) => known.state === "done" && known.request.session === session);
if (diagnosis) {
  screens.diagnose += `?run=${diagnosis.id}`;
  screens.timelines += `&diagnosed=diagnosis:${diagnosis.id}`;
}

for (const [width, height] of [[1280, 800], [1920, 1080]]) {
  for (const colorScheme of ["light", "dark"]) {
    const { context, page } = await openBrowser({ width, height, colorScheme });
    for (const [name, hash] of Object.entries(screens)) {
      await page.goto(`${url}/${hash}`);
      await page.reload();
      await page.waitForFunction(() => !document.getElementById("skeleton"));
      await page.waitForTimeout(4000);
      await page.screenshot({ path: join(out, `${name}-${width}-${colorScheme}.png`) });
    }
    await context.close();
  }
}
