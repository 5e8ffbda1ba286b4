// What the scripts for live stations share: named steps, the station's own word, an operator who is in control.
import assert from "node:assert/strict";
import { join } from "node:path";
import { openBrowser } from "./browser.mjs";

/** Whatever is waited for comes long before this, unless it never does. */
const PATIENCE_MS = 120_000;

/** The first window on the studio at `url`, and what the scripts do with it. */
export async function openStation(url, shots) {
  const { context, page, errors } = await openBrowser();
  const api = (path) => `${url}/api/v1/${path}`;
  const button = (name, on = page) => on.getByRole("button", { name, exact: true });
  const shot = (name, on = page) => on.screenshot({ path: join(shots, `${name}.png`) });
  const get = async (path) => (await context.request.get(api(path))).json();
  const live = () => get("live");

  /** Waits until `ask` gives what is `wanted`; gives that. */
  async function until(what, wanted, ask = live, patience_ms = PATIENCE_MS) {
    const start = Date.now();
    for (;;) {
      const state = await ask();
      if (await wanted(state)) return state;
      assert.ok(Date.now() - start < patience_ms, `never ${what}: ${JSON.stringify(state)}`);
      await page.waitForTimeout(50);
    }
  }

  async function step(name, run) {
    const start = Date.now();
    try {
      await run();
      console.log(`ok   ${name} (${((Date.now() - start) / 1000).toFixed(1)} s)`);
    } catch (error) {
      await shot("failure");
      console.error(`FAIL ${name}\n${error.stack}\n${errors.join("\n")}\n${JSON.stringify(await live())}`);
      await context.close();
      process.exit(1);
    }
  }

  const allReady = (state) => state.devices.length > 0 && state.devices.every((device) => device.link === "ready");

  /** Arms; where the machine was too slow for the station, again. */
  async function arm() {
    await until("armed", async (state) => {
      if (state.phase === "armed") return true;
      if (state.phase === "disarmed" && (await button("Arm").isVisible()) && !(await disabled(button("Arm")))) {
        await button("Arm").click({ timeout: 2000 }).catch(() => {});
      }
      return false;
    });
  }

  /** Takes control; a browser that does not know who sits there asks first. */
  async function takeControl(name) {
    await button("Take control").click();
    await page.getByRole("textbox", { name: "Your name" }).fill(name);
    await button("Continue").click();
    await page.getByText("You have control").waitFor();
  }

  /** Arms, and does `act` until the station is as `wanted`: where the machine was too slow for the station, again. */
  async function whileArmed(what, act, wanted) {
    await until(what, async (state) => {
      if (wanted(state)) return true;
      await arm();
      await act();
      await page.waitForTimeout(700);
      return wanted(await live());
    });
  }

  return { context, page, errors, button, shot, get, live, until, step, allReady, arm, whileArmed, takeControl };
}

/** Whether a button or a field can be used now. */
export async function disabled(locator) {
  return (await locator.getAttribute("aria-disabled")) === "true";
}

/**
 * The errors of a page but for those that Chromium logs where the station refused (409): one that held in the meantime, because the
 * machine was too slow for it, does so, and the page tells the operator.
 */
export function faults(errors) {
  return errors.filter((error) => !error.includes("status of 409"));
}
