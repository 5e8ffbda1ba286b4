// A page of another origin, in a real browser: it opens no socket, changes nothing, and cannot frame the studio.
// Usage: node foreign.mjs URL SCREENSHOT_DIR
import assert from "node:assert/strict";
import { createServer } from "node:http";
import { openStation } from "./station.mjs";

const [url, shots] = process.argv.slice(2);
const station = await openStation(url, shots);
const { context, page, live, until, step } = station;

// A neighbour on the same computer, as a notebook or a development server is: no browser's network rules keep it away.
const neighbour = createServer((_, response) => {
  response.setHeader("content-type", "text/html");
  response.end("<!doctype html><title>neighbour</title>");
});
await new Promise((listening) => neighbour.listen(0, "127.0.0.1", listening));
const elsewhere = `http://127.0.0.1:${neighbour.address().port}`;

const opens = (socket) =>
  page.evaluate(
    (socket) =>
      new Promise((resolve) => {
        const opened = new WebSocket(socket);
        opened.onopen = () => resolve(true);
        opened.onerror = () => resolve(false);
      }),
    socket,
  );

await step("the studio's own page opens its sockets", async () => {
  await until("ready", station.allReady);
  await page.goto(url);
  for (const path of ["control", "stream"]) assert.ok(await opens(`${url.replace("http", "ws")}/api/v1/${path}`), path);
});

await step("a page of another origin opens none", async () => {
  await page.goto(elsewhere);
  for (const path of ["control", "stream"]) {
    assert.ok(!(await opens(`${url.replace("http", "ws")}/api/v1/${path}`)), `${path} was opened`);
  }
});

await step("nor does it change anything by requests that browsers send without asking", async () => {
  for (const path of ["sessions/demo/restore", "calibrations/run-1/cancel", "recording/act", "models/demo/undo"]) {
    const target = `${url}/api/v1/${path}`;
    const send = (target) => fetch(target, { method: "POST", mode: "no-cors" }).then(() => true, () => false);
    assert.equal(await page.evaluate(send, target), false, `${path}: the page was given an answer`);
    // What the studio makes of it, which no page is told: the same request with the same origin.
    const answer = await context.request.post(target, { headers: { origin: elsewhere } });
    assert.equal(answer.status(), 403, path);
  }
});

await step("nor does it frame the studio", async () => {
  await page.evaluate((src) => {
    const frame = Object.assign(document.createElement("iframe"), { src });
    document.body.append(frame);
    return new Promise((resolve) => (frame.onload = frame.onerror = resolve));
  }, url);
  const framed = page.frames().find((frame) => frame !== page.mainFrame());
  const shown = framed === undefined ? 0 : await framed.locator("canvas").count().catch(() => 0);
  assert.equal(shown, 0, "the studio is shown in a frame");
});

const state = await live();
assert.equal(state.holder, "");
assert.equal(state.phase, "disarmed");
neighbour.close();
await context.close();
