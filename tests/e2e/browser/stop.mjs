// STOP can be pressed at every size of the window and every zoom: nothing that takes clicks meets it, and a click on it
// stops. Usage: node stop.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { faults, openStation } from "./station.mjs";

const [url, shots] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, errors, button, shot, live, until, step } = station;

const SIZES = [[320, 640], [390, 844], [640, 400], [900, 600], [1280, 800], [1920, 1080]];
const ZOOMS = [1, 1.5, 2];
/** Smaller windows than this, in CSS pixels, are nobody's. */
const NARROWEST = 320;
const STOP = "STOP (software)";
const SCREENS = [
  "home",
  "hand?source=live",
  "record",
  "timelines",
  "calibrate",
  "diagnose",
  "sessions",
  "objects",
  "plans",
  "models",
  "trials",
  "jobs",
  "settings",
];

const devtools = await context.newCDPSession(page);

/**
 * A window of so many screen pixels at a zoom, as a browser lays it out: fewer, larger CSS pixels. The scale of the
 * screen is left alone, because an emulated one does not reach the size of the canvas in device pixels.
 */
async function resize([width, height], zoom) {
  const metrics = { width: Math.round(width / zoom), height: Math.round(height / zoom), deviceScaleFactor: 1 };
  await devtools.send("Emulation.setDeviceMetricsOverride", { ...metrics, mobile: false });
  // STOP stands 8 points from the right edge once the page is drawn at its new size.
  const drawn = async () => {
    const box = stopOf(await boxes());
    const inner = await page.evaluate(() => window.innerWidth);
    return box !== undefined && inner === metrics.width && Math.abs(box.right - (inner - 8)) < 1.5;
  };
  await until(`drawn at ${width} x ${height}, zoom ${zoom}`, (done) => done, drawn);
  return metrics;
}

/** What takes clicks, as boxes of the elements over the canvas. */
const boxes = () =>
  page.evaluate(() =>
    [...document.querySelectorAll("#mirror > .on")].map((element) => {
      const { left, top, right, bottom } = element.getBoundingClientRect();
      const name = element.getAttribute("aria-label") ?? element.textContent;
      return { name, role: element.getAttribute("role") ?? element.tagName, left, top, right, bottom };
    }),
  );

/** STOP among the boxes: the palette lists it too, further left. */
const stopOf = (all) => all.filter(({ name }) => name === STOP).sort((a, b) => b.right - a.right)[0];

async function assertFree(what) {
  const all = await boxes();
  const stop = stopOf(all);
  assert.ok(stop, `${what}: there is no STOP`);
  assert.ok(stop.right - stop.left >= 44 && stop.bottom - stop.top >= 44, `${what}: STOP is too small to hit`);
  const inner = await page.evaluate(() => window.innerWidth);
  assert.ok(stop.left >= 0 && stop.right <= inner, `${what}: STOP is off the window`);
  const others = all.filter(
    (box) =>
      box !== stop &&
      // What shades the page behind a dialog spans all of it, and lies under STOP.
      box.right - box.left < inner &&
      box.left < stop.right &&
      box.right > stop.left &&
      box.top < stop.bottom &&
      box.bottom > stop.top,
  );
  assert.deepEqual(others, [], `${what}: in the way of STOP at ${JSON.stringify(stop)}`);
  return stop;
}

await step("the page shows the live station", async () => {
  await until("ready", station.allReady);
  await page.goto(`${url}/#/hand?source=live`);
  await button(STOP).waitFor();
});

await step("no box meets STOP's at any size and zoom", async () => {
  for (const size of SIZES) {
    for (const zoom of ZOOMS.filter((zoom) => size[0] / zoom >= NARROWEST)) {
      await resize(size, zoom);
      await assertFree(`${size.join(" x ")}, zoom ${zoom}`);
    }
  }
});

await step("nor on any screen of the smallest windows, nor with the palette open", async () => {
  for (const [size, zoom] of [[SIZES[0], 1], [[1280, 800], 2]]) {
    await resize(size, zoom);
    for (const screen of SCREENS) {
      await page.evaluate((hash) => (location.hash = hash), `#/${screen}`);
      await page.waitForTimeout(700);
      await assertFree(`${size.join(" x ")}, zoom ${zoom}, ${screen}`);
    }
    await page.keyboard.press("Control+k");
    await page.getByRole("textbox", { name: "Command" }).waitFor();
    await assertFree(`${size.join(" x ")}, zoom ${zoom}, palette`);
    await shot(`stop-${size[0]}-zoom-${zoom}`);
    await page.keyboard.press("Escape");
  }
});

await step("a click on STOP in the narrowest window stops the station", async () => {
  await resize(SIZES[0], 1);
  const stop = await assertFree("narrowest");
  assert.notEqual((await live()).phase, "stopped");
  await page.mouse.click((stop.left + stop.right) / 2, (stop.top + stop.bottom) / 2);
  await until("stopped", (state) => state.phase === "stopped");
  await page.getByText("STOPPED", { exact: true }).first().waitFor();
  await shot("stop-narrowest");
});

assert.deepEqual(faults(errors), [], "the page logged errors");
await context.close();
