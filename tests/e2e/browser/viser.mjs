// Takes a picture of a viser page once its scene is drawn and does not change any more.
// Usage: node viser.mjs URL PICTURE.png TEXT (that the page's controls show when the scene is there)
import { openBrowser } from "./browser.mjs";

const [url, picture, text] = process.argv.slice(2);
const { context, page } = await openBrowser({ width: 1000, height: 700 });
await page.goto(url);
await page.locator("canvas").first().waitFor();
const shows = (wanted) => [...document.querySelectorAll("input")].some((input) => input.value.includes(wanted));
await page.waitForFunction(shows, text);
// A browser without a graphics card is told so, over the picture.
await page.addStyleTag({ content: ".mantine-Notification-root { display: none }" });
// Controls come before meshes do. A scene without motion is there when two pictures are the same; one that moves gets five.
let before = null;
for (let look = 0; look < 5; look += 1) {
  await page.waitForTimeout(1000);
  const now = await page.screenshot({ path: picture });
  if (before !== null && now.equals(before)) break;
  before = now;
}
await context.close();
