// A headless Chromium that renders WebGL 2 in software, and a page that fails the test on any error of its own.
import { mkdtempSync, rmSync } from "node:fs";
import { setPriority, tmpdir } from "node:os";
import { join } from "node:path";
import { chromium } from "playwright-core";

const FLAGS = [
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
  // Mesa's llvmpipe: it takes half the time of Chromium's own SwiftShader.
  "--use-gl=angle",
  "--use-angle=gl-egl",
  "--ignore-gpu-blocklist",
];

const ENVIRONMENT = {
  LIBGL_ALWAYS_SOFTWARE: "1",
  // llvmpipe draws in the thread that asks for it: with threads of its own, one may still write into a fence that another has freed,
  // and Chromium's process for graphics ends (Mesa 22.3: "FreelistCorruptionDetected").
  LP_NUM_THREADS: "0",
  // Chromium sets these when it starts, while another of its threads looks for a variable to resolve names by, and crashes where that
  // moves the environment. Nothing moves if they are there.
  FC_FONTATIONS: "1",
  DBUS_SESSION_BUS_ADDRESS: "disabled:",
};

const executablePath = process.env.PALPATE_CHROMIUM ?? "/usr/bin/chromium";

export async function openBrowser({ width = 1280, height = 800, colorScheme = "light" } = {}) {
  // Pictures are drawn by the processor here: they must not keep a station that runs in real time waiting.
  setPriority(10);
  const viewport = { width, height };
  const context = await inOwnFolder((folder, options) =>
    chromium.launchPersistentContext(join(folder, "profile"), { ...options, viewport, colorScheme }),
  );
  context.setDefaultTimeout(60_000);
  const page = context.pages()[0] ?? (await context.newPage());
  return { context, page, errors: collectErrors(page) };
}

/** A browser whose contexts share nothing, as computers of several people do. */
export async function launchBrowser() {
  setPriority(10);
  return inOwnFolder((_folder, options) => chromium.launch(options));
}

/** Launches a browser that keeps all its files in one folder. The folder goes when this process ends, because nobody else removes a
 * profile, or what a browser leaves that is killed in the middle of a test that fails. */
async function inOwnFolder(launch) {
  const folder = mkdtempSync(join(tmpdir(), "chromium-"));
  try {
    const env = { ...process.env, ...ENVIRONMENT, TMPDIR: folder };
    return await launch(folder, { executablePath, args: FLAGS, env });
  } finally {
    // After the launch: Playwright kills the browser when this process ends, and has to come first.
    process.on("exit", () => rmSync(folder, { recursive: true, force: true, maxRetries: 10, retryDelay: 50 }));
  }
}

/** The first window of somebody else's computer, which trusts whatever certificate a studio made for itself. */
export async function openContext(browser, { width = 1280, height = 800, hasTouch = false } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, hasTouch, ignoreHTTPSErrors: true });
  // Several pages that are drawn by one processor come slowly.
  context.setDefaultTimeout(180_000);
  const page = await context.newPage();
  return { context, page, errors: collectErrors(page) };
}

/** Another window of the same browser. */
export async function openPage(context) {
  const page = await context.newPage();
  return { page, errors: collectErrors(page) };
}

/** The id of the element that has the focus, unless it is `known`; runs in the page. The canvas keeps the browser's focus and names the
 * element that has its own; text fields take the browser's. */
function focusBeside(known) {
  const active = document.activeElement;
  const id = active?.getAttribute("aria-activedescendant") ?? active?.id ?? "";
  return id !== known && { id };
}

/** Within this Tab has moved the focus, if there is anything else that takes it. */
const TAB_MS = 2000;

/** Goes to an element with Tab, and presses a key there: what somebody without a pointer does. */
export async function byKeyboard(page, role, name, key = "Enter") {
  const wanted = page.getByRole(role, { name, exact: true }).first();
  await wanted.waitFor();
  for (let presses = 0; presses < 400; presses += 1) {
    const focus = await page.evaluate(focusBeside, null);
    if (focus.id === (await wanted.getAttribute("id"))) {
      await page.keyboard.press(key);
      return;
    }
    await page.keyboard.press("Tab");
    // The page draws a frame before its mirror has the focus.
    await page.waitForFunction(focusBeside, focus.id, { timeout: TAB_MS }).catch(() => {});
  }
  throw new Error(`Tab never reaches ${role} ${name}`);
}

/** A request as a page of `on` makes it. */
export const request = (on, method, path, body) =>
  on.page.evaluate(
    async ([method, path, body]) => {
      const headers = { "content-type": "application/json" };
      const answer = await fetch(`/api/v1${path}`, { method, headers, body: body && JSON.stringify(body) });
      return { status: answer.status, text: await answer.text() };
    },
    [method, path, body],
  );

function collectErrors(page) {
  const errors = [];
  page.on("pageerror", (error) => errors.push(String(error)));
  page.on("console", (message) => {
    if (message.type() === "error") errors.push(message.text());
  });
  return errors;
}
