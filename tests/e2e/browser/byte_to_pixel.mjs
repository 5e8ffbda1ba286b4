// Notes when messages with a jump of one channel reach the page, and when its picture of the hand shows the jump.
// Usage: node byte_to_pixel.mjs URL SCREENSHOT_DIR CHANNEL MIDDLE JUMPS OUT.json
//   CHANNEL: place in the layout; MIDDLE: a reading between the two that it jumps between; JUMPS: how many to wait for
// Times are ms since 1970 by the clock of this machine. A frame counts as painted once a pixel of it could be read back
// from the canvas in the task that drew it: what the browser needs to put it on a screen comes on top.
import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { faults, openStation } from "./station.mjs";

const [url, shots, channel, middle, jumps, out] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, errors, button, shot, until, step } = station;

/** Runs in the page before anything else of it. */
function instrument({ channel, middle }) {
  const seen = { messages: [], frames: [], pixel: null, up: null, learn: null };
  window.byteToPixel = seen;
  const now_ms = () => performance.timeOrigin + performance.now();

  // StreamMessage.live (1) . LiveFrame.raw (4, packed floats).
  function field(bytes, wanted) {
    let at = 0;
    const varint = () => {
      let value = 0;
      for (let shift = 1; ; shift *= 128) {
        const byte = bytes[at++];
        value += (byte & 127) * shift;
        if (byte < 128) return value;
      }
    };
    while (at < bytes.length) {
      const tag = varint();
      const [number, kind] = [Math.floor(tag / 8), tag & 7];
      if (kind === 2) {
        const length = varint();
        if (number === wanted) return bytes.subarray(at, at + length);
        at += length;
      } else if (kind === 0) varint();
      else at += kind === 1 ? 8 : 4;
    }
    return null;
  }
  function reading(buffer) {
    const live = field(new Uint8Array(buffer), 1);
    const raw = live && field(live, 4);
    if (!raw || raw.length < 4 * (channel + 1)) return null;
    return new DataView(raw.buffer, raw.byteOffset).getFloat32(4 * channel, true);
  }

  const Socket = window.WebSocket;
  window.WebSocket = class extends Socket {
    constructor(address, protocols) {
      super(address, protocols);
      if (!String(address).endsWith("/stream")) return;
      this.addEventListener("message", ({ data }) => {
        const value = reading(data);
        if (value === null) return;
        const up = value > middle;
        if (seen.up !== null && up !== seen.up) seen.messages.push({ at_ms: now_ms(), up });
        seen.up = up;
      });
    }
  };

  let gl = null;
  const getContext = HTMLCanvasElement.prototype.getContext;
  HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
    const made = getContext.call(this, kind, ...rest);
    if (this.id === "palpate" && kind === "webgl2") gl = made;
    return made;
  };

  function read(x, y, width, height) {
    const bound = gl.getParameter(gl.READ_FRAMEBUFFER_BINDING);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    const pixels = new Uint8Array(4 * width * height);
    gl.readPixels(x, y, width, height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, bound);
    return pixels;
  }
  function afterFrame(begun_ms) {
    if (!gl) return;
    if (seen.learn) {
      const { drawingBufferWidth: width, drawingBufferHeight: height } = gl;
      seen.learn({ width, height, pixels: read(0, 0, width, height) });
      seen.learn = null;
    }
    if (!seen.pixel) return;
    const { x, y, low, high } = seen.pixel;
    const pixel = read(x, y, 1, 1);
    const far = (from) => Math.hypot(pixel[0] - from[0], pixel[1] - from[1], pixel[2] - from[2]);
    seen.frames.push({ begun_ms, painted_ms: now_ms(), up: far(high) < far(low) });
  }
  // What was drawn can be read until the task ends.
  const request = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (callback) =>
    request((time) => {
      const begun_ms = now_ms();
      callback(time);
      afterFrame(begun_ms);
    });

  const picture = () => new Promise((resolve) => (seen.learn = resolve));
  const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  /** A picture some time after the reading went up or down, when it shows that. */
  async function settled(up) {
    while (seen.up === up) await pause(5);
    while (seen.up !== up) await pause(5);
    await pause(350);
    return picture();
  }
  /** Finds a pixel that shows the reading and nothing else. */
  window.findPixel = async () => {
    const [lows, highs] = [[], []];
    for (let round = 0; round < 3; round += 1) {
      highs.push(await settled(true));
      lows.push(await settled(false));
    }
    const { width, height } = lows[0];
    const at = ({ pixels }, i) => [pixels[4 * i], pixels[4 * i + 1], pixels[4 * i + 2]];
    const same = (pictures, i) => pictures.every((one) => at(one, i).every((c, k) => c === at(pictures[0], i)[k]));
    const shows = (i) => {
      const [low, high] = [at(lows[0], i), at(highs[0], i)];
      return Math.hypot(...low.map((c, k) => c - high[k])) > 60 && same(lows, i) && same(highs, i);
    };
    for (let y = 1; y < height - 1; y += 1) {
      for (let x = 1; x < width - 1; x += 1) {
        const i = y * width + x;
        if ([-width, -1, 0, 1, width].every((by) => shows(i + by))) {
          seen.pixel = { x, y, low: at(lows[0], i), high: at(highs[0], i), width, height };
          return seen.pixel;
        }
      }
    }
    return null;
  };
}

await page.addInitScript(instrument, { channel: Number(channel), middle: Number(middle) });
let found;

await step("the page shows the live hand", async () => {
  await until("ready", station.allReady);
  await page.goto(`${url}/#/hand`);
  await page.reload();
  await button("Live").click();
  await page.getByText(/LIVE/).first().waitFor();
  // The flat map has larger taxels than the picture.
  await page.getByRole("tab", { name: "Touch", exact: true }).or(page.getByRole("radio", { name: "Touch", exact: true })).click();
});

await step("a pixel shows the jumps of the reading", async () => {
  found = await page.evaluate(() => window.findPixel());
  assert.ok(found, "no pixel follows the reading");
  await shot("byte-to-pixel");
});

await step(`${jumps} jumps are seen`, async () => {
  await page.evaluate(() => (window.byteToPixel.messages.length = 0));
  await page.waitForFunction(
    (jumps) => window.byteToPixel.messages.length > jumps,
    Number(jumps),
    { polling: 500, timeout: 120_000 },
  );
});

const { messages, frames } = await page.evaluate(() => {
  const { messages, frames } = window.byteToPixel;
  return { messages, frames };
});
writeFileSync(out, JSON.stringify({ pixel: found, messages, frames }));
assert.deepEqual(faults(errors), [], "the page logged errors");
await context.close();
