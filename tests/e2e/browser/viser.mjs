// Takes a picture of a viser page once its scene is drawn and does not change any more.
// Usage: node viser.mjs URL PICTURE.png TEXT (that the page's controls show when the scene is there)
import assert from "node:assert/strict";
import { openBrowser } from "./browser.mjs";

const [url, picture, text] = process.argv.slice(2);
const { context, page } = await openBrowser({ width: 1000, height: 700 });
await page.goto(url);
await page.locator("canvas").first().waitFor();
await page.waitForFunction((wanted) => [...document.querySelectorAll("input")].some((input) => input.value.includes(wanted)), text);
const before = { picture: null };
for (let look = 0; look < 60; look += 1) {
  await page.waitForTimeout(1500);
  const now = await page.screenshot({ path: picture });
  if (before.picture !== null && now.equals(before.picture)) break;
  before.picture = now;
}
assert.ok(before.picture !== null, "no picture was taken");
await context.close();
