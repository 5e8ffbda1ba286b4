// Three people with logins of their own: an operator plans a campaign, leads it and closes it; a scorer on a phone scores its
// trials blind as they come in; a viewer can neither move the station nor score. Trials are made by a rollout that the test
// starts as soon as there is a campaign. Usage: node campaign.mjs URL SCREENSHOT_DIR SCORED_FILE STARTS
// People are those of policy/train/tests/hand/campaign_page.rs.
import assert from "node:assert/strict";
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { launchBrowser, openContext, request } from "./browser.mjs";

const [url, shots, scoredFile, starts] = process.argv.slice(2);
const numStarts = Number(starts);

/** A trial takes a quarter of a minute; whatever is waited for comes long before this, unless it never does. */
const PATIENCE_MS = 180_000;
const NUM_TRIALS = 4 * numStarts;
/** Names of the policies, and what else would tell a blind scorer which one moved the hand. */
const POLICIES = [
  { id: "expert-arm", source: "{object}.safetensors" },
  { id: "numb-arm", source: "{object}.safetensors" },
];
const TELLTALES = [...POLICIES.map(({ id }) => id), "{object}", "safetensors", "touch silenced", '"is_silenced":true'];
/** Key and label of each verdict. */
const VERDICTS = {
  success: ["s", "success"],
  EG: ["e", "empty grasp"],
  SL: ["l", "slip"],
  ES: ["x", "emergency stop"],
  void: ["v", "void"],
};
/** What the scorer says of each trial: all verdicts occur, whichever policy it was. */
const verdictOf = (trial) => (trial === 7 ? "void" : ["success", "EG", "success", "SL", "ES", "success"][trial % 6]);
/** The trial whose first verdict is taken back. */
const TAKEN_BACK = 2;

const browser = await launchBrowser();
const operator = await openContext(browser);
const scorer = await openContext(browser, { width: 390, height: 844, hasTouch: true });
const viewer = await openContext(browser);
const everybody = { operator, scorer, viewer };

const button = (name, on) => on.page.getByRole("button", { name, exact: true });
const says = (text, on) => on.page.getByText(text).first();
const shot = (name, on) => on.page.screenshot({ path: join(shots, `campaign-${name}.png`) });
const isDisabled = async (locator) => (await locator.getAttribute("aria-disabled")) === "true";

async function step(name, run) {
  const start = Date.now();
  try {
    await run();
    console.log(`ok   ${name} (${((Date.now() - start) / 1000).toFixed(1)} s)`);
  } catch (error) {
    for (const [who, on] of Object.entries(everybody)) await shot(`failure-${who}`, on).catch(() => {});
    const errors = Object.values(everybody).flatMap((on) => on.errors);
    console.error(`FAIL ${name}\n${error.stack}\n${errors.join("\n")}`);
    await browser.close();
    process.exit(1);
  }
}

/** Waits until `ask` gives something; gives that. */
async function until(what, ask, patience_ms = PATIENCE_MS) {
  const start = Date.now();
  for (;;) {
    const answer = await ask();
    if (answer) return answer;
    assert.ok(Date.now() - start < patience_ms, `never ${what}`);
    await operator.page.waitForTimeout(100);
  }
}

/**
 * Presses `control`, and once more if what is to be `seen` then is not. People press again what did nothing; it is told,
 * because it should not happen.
 */
async function press(control, seen, how = () => control.click()) {
  await how();
  const isSeen = await seen.waitFor({ timeout: 20_000 }).then(() => true, () => false);
  if (isSeen) return;
  console.log(`RETRY ${control}: it did nothing within 20 s`);
  await how();
  await seen.waitFor();
}
const tab = (name, on) => on.page.getByRole("tab", { name, exact: true });

const document = async (path, on = operator) => JSON.parse((await request(on, "GET", path)).text);

async function logIn(on, name) {
  await on.page.goto(url);
  await on.page.getByLabel("Name").fill(name);
  await on.page.getByLabel("Password").fill(`a password of ${name}`);
  await on.page.getByRole("button", { name: "Log in" }).click();
  await button("Trials", on).waitFor();
}

/** Where something that the scorer is not to know came to their page; empty as long as it is blind. */
const leaks = [];
let isBlind = true;
const search = (where, text) => {
  for (const telltale of TELLTALES.filter((telltale) => isBlind && text.includes(telltale))) {
    leaks.push(`${telltale} in ${where}: ${text.slice(0, 300)}`);
  }
};
const pending = [];
scorer.page.on("response", (answer) => {
  const { pathname } = new URL(answer.url());
  if (!pathname.startsWith("/api/")) return;
  pending.push(answer.text().then((text) => search(pathname, text), () => {}));
});
scorer.page.on("websocket", (socket) => {
  socket.on("framereceived", ({ payload }) => search(socket.url(), Buffer.from(payload).toString("latin1")));
});
// Whatever the page ever said, also for one frame.
await scorer.page.exposeFunction("said", (text) => search("the page", text));
await scorer.page.addInitScript((telltales) => {
  const read = (node) => {
    for (const text of [node.textContent, node.getAttribute?.("aria-label"), node.value]) {
      if (text && telltales.some((telltale) => text.includes(telltale))) window.said(text);
    }
  };
  new MutationObserver((changes) => {
    for (const { type, target, addedNodes } of changes) (type === "childList" ? addedNodes : [target]).forEach(read);
  }).observe(window.document, { subtree: true, childList: true, characterData: true, attributes: true });
}, TELLTALES);

await step("three people log in", async () => {
  await logIn(operator, "olga");
  await logIn(scorer, "ada");
  await logIn(viewer, "vera");
  for (const on of [scorer, viewer]) {
    await button("Trials", on).click();
    await says("No campaign yet", on).waitFor();
    assert.equal(await button("Plan a campaign", on).count(), 0, "only operators plan campaigns");
  }
});

await step("the operator plans a campaign", async () => {
  const { page } = operator;
  // The page takes a text in with its next frame, and shows what it has then: a field that lost it is written again.
  const write = (name, text, role = "textbox") =>
    until(`${name} written`, async () => {
      const field = page.getByRole(role, { name, exact: true });
      if ((await field.inputValue()) !== text) await field.fill(text);
      await page.waitForTimeout(500);
      return (await field.inputValue()) === text;
    });
  await button("Trials", operator).click();
  await button("Plan a campaign", operator).click();
  await write("Name", "Two arms");
  await button("Add a policy", operator).click();
  for (const [idx, { id, source }] of POLICIES.entries()) {
    await write(`Name of policy ${idx + 1}`, id);
    await write(`Source of policy ${idx + 1}`, source);
  }
  await page.getByRole("checkbox", { name: "touch silenced" }).nth(1).click();
  for (const object of ["cube", "ball"]) await button(object, operator).click();
  await write("Starts of each object", starts, "spinbutton");
  // What does not fit into the window is scrolled to, as people do it.
  await page.mouse.move(640, 500);
  await page.mouse.wheel(0, 2000);
  await page.waitForTimeout(500);
  await page.getByRole("checkbox", { name: "Blind", exact: true }).click();
  await says(`2 policies × 2 objects × ${starts} starts = ${NUM_TRIALS} trials`, operator).waitFor();
  await shot("plan", operator);
  await button("Make the campaign", operator).click();
  await says(new RegExp(`^Trial 1 of ${NUM_TRIALS}: (cube|ball) with (expert|numb)-arm$`), operator).waitFor();
});

const { id, trials } = await document("/campaigns/two-arms").then((made) => ({ id: made.summary.id, ...made }));
assert.equal(trials.length, NUM_TRIALS);
const campaign = () => document(`/campaigns/${id}`);

await step("the operator takes a break while the first trial runs", async () => {
  await until("a trial runs", async () => (await campaign()).trials.some(({ state }) => state === "running"));
  await press(button("Take a break", operator), says("The campaign is paused", operator));
  await until("control is given back", async () => (await document("/live")).holder === "");
  await shot("break", operator);
  const made = (await campaign()).trials.filter(({ state }) => state !== "waiting").length;
  assert.ok(made < NUM_TRIALS, "the break came too late to mean anything");
});

await step("the viewer sees that it is paused, without a button that moves or scores", async () => {
  const NOT_THEIRS = ["It is placed: begin", "It has ended", "Take a break", "Close the campaign", "Plan a campaign"];
  await says("The campaign is paused", viewer).waitFor();
  for (const name of NOT_THEIRS) assert.equal(await button(name, viewer).count(), 0, name);
  const control = viewer.page.getByRole("button", { name: /^(Take over|Take control)$/ }).first();
  await control.waitFor();
  assert.ok(await isDisabled(control), "a viewer can take control");
  await shot("viewer", viewer);
  await press(tab("Score", viewer), says("Scorers and operators score trials", viewer));
  assert.equal(await viewer.page.getByRole("button", { name: /^Score: / }).count(), 0);
  await press(tab("Results", viewer), says("This campaign is blind", viewer));
});

await step("what a page of the viewer or the scorer asks for all the same is refused", async () => {
  const score = { attempt: 0, verdict: "success" };
  const scoring = [
    ["POST", `/campaigns/${id}/trials/1/score`, score],
    ["POST", `/campaigns/${id}/trials/1/unscore`, { attempt: 0 }],
  ];
  const moving = [
    ["POST", "/campaigns", { name: "Mine" }],
    ["POST", `/campaigns/${id}/trials/${NUM_TRIALS}/begin`],
    ["POST", `/campaigns/${id}/trials/1/outcome`, { attempt: 0, outcome: { reasons: [] } }],
    ["POST", `/campaigns/${id}/trials/1/settle`, score],
    ["POST", `/campaigns/${id}/pause`],
    ["POST", `/campaigns/${id}/resume`],
    ["POST", `/campaigns/${id}/close`],
    ["POST", `/campaigns/${id}/reopen`],
    ["POST", "/recording", {}],
    ["POST", "/recording/act", {}],
    ["POST", "/jobs", {}],
  ];
  for (const [on, requests] of [[viewer, [...moving, ...scoring]], [scorer, moving]]) {
    for (const asked of requests) assert.equal((await request(on, ...asked)).status, 403, asked.join(" "));
    // What a page that knows no better would send to take the station from whoever has it: Acquire, with take_over.
    const reply = await on.page.evaluate(
      () =>
        new Promise((resolve, reject) => {
          const socket = new WebSocket(`wss://${location.host}/api/v1/control`);
          socket.binaryType = "arraybuffer";
          socket.onopen = () => socket.send(new Uint8Array([8, 1, 0x1a, 8, 0x0a, 4, 0x76, 0x65, 0x72, 0x61, 0x10, 1]));
          socket.onmessage = ({ data }) => (resolve(new TextDecoder("latin1").decode(data)), socket.close());
          socket.onerror = reject;
        }),
    );
    assert.ok(reply.includes("you may watch and press STOP"), reply);
  }
  assert.ok(!["vera", "ada"].includes((await document("/live")).holder));
});

/** What was scored, by trial. */
const scored = new Map();

/** The number of the trial that waits for the scorer's verdict, once it is another one than those that have theirs. */
async function trialToScore() {
  return until("a trial to score", async () => {
    const [title] = await scorer.page.getByText(/^Trial \d+: (cube|ball)$/).allTextContents();
    const number = title && Number(title.match(/\d+/)[0]);
    return scored.has(number) ? undefined : number;
  });
}

/** Scores by a key, by a finger or by a pointer, as phones and desks do. */
async function score(number, verdict, how) {
  const [key, label] = VERDICTS[verdict];
  const control = button(`Score: ${label}`, scorer);
  await until("a button that can be pressed", async () => (await control.count()) === 1 && !(await isDisabled(control)));
  const known = scorer.page.getByText(new RegExp(`^Trial ${number} \\((cube|ball)\\): ${label}$`));
  await press(control, known, async () => {
    assert.equal(await trialToScore(), number, "another trial was scored");
    if (how === "key") return scorer.page.keyboard.press(key);
    return how === "touch" ? control.tap() : control.click();
  });
  scored.set(number, verdict);
}

/** Takes a verdict back. On a phone it is below the window where the next trial is there already: people scroll. */
async function takeBack(number) {
  const { page } = scorer;
  const { width, height } = page.viewportSize();
  const scroll = async (down_px) => {
    await page.mouse.move(width / 2, height / 2);
    await page.mouse.wheel(0, down_px);
    await page.waitForTimeout(500);
  };
  await until(`verdict ${number} taken back`, async () => {
    await scroll(2000);
    return button(`Take back ${number}`, scorer).click({ timeout: 2000 }).then(() => true, () => false);
  });
  await scroll(-2000);
}

await step("the scorer's page shows what there is to score, and no policy", async () => {
  await says("This campaign is blind", scorer).waitFor();
  await says("You score as ada.", scorer).waitFor();
  const number = await trialToScore();
  await shot("scorer", scorer);
  await shot("operator", operator);
  await press(tab("Run", scorer), says("The campaign is paused", scorer));
  await shot("scorer-run", scorer);
  await press(tab("Score", scorer), says("You score as ada.", scorer));
  assert.equal(await trialToScore(), number);
});

await step("the operator goes on", async () => {
  await button("Go on", operator).click();
  await until("it goes on", async () => !(await campaign()).paused);
});

await step(`the scorer scores ${NUM_TRIALS} trials as they come in`, async () => {
  while (scored.size < NUM_TRIALS) {
    const number = await trialToScore();
    const how = ["key", "touch", "pointer"][number % 3];
    if (number === TAKEN_BACK) {
      await score(number, "SL", how);
      await takeBack(number);
      scored.delete(number);
      await scorer.page.getByText(new RegExp(`^Trial ${number}: `)).waitFor();
    }
    await score(number, verdictOf(number), how);
  }
  await says("Nothing to score now", scorer).waitFor();
});

await step("until here nothing told the scorer which policy moved the hand", async () => {
  for (const path of [`/campaigns/${id}/results`, `/campaigns/${id}/tables/trials.csv`]) {
    assert.equal((await request(scorer, "GET", path)).status, 409, path);
  }
  for (const path of ["/campaigns", `/campaigns/${id}`, "/audit", "/jobs", "/live"]) await request(scorer, "GET", path);
  await Promise.all(pending);
  assert.deepEqual(leaks, []);
  isBlind = false;
});

await step("the operator closes the campaign, and everybody sees the results", async () => {
  await says("All trials are made", operator).waitFor();
  await button("Repeat trial 7", operator).waitFor();
  await press(button("Close the campaign", operator), says("The campaign is closed", operator));
  for (const [who, on] of Object.entries(everybody)) {
    await on.page.getByRole("tab", { name: "Results", exact: true }).click();
    for (const { id } of POLICIES) {
      await on.page.getByText(new RegExp(`^${id}: \\d+/\\d+`)).or(on.page.getByLabel(new RegExp(`^${id}: \\d+/\\d+`))).first().waitFor();
    }
    await shot(`results-${who}`, on);
  }
});

/** Rows of comma-separated values without quotes, by the names in the first line. */
function rows(csv) {
  const [head, ...lines] = csv.trim().split("\n").map((line) => line.split(","));
  return lines.map((cells) => Object.fromEntries(head.map((name, idx) => [name, cells[idx]])));
}

await step("what is exported is what was scored, trial by trial", async () => {
  const { trials } = await campaign();
  const csv = rows((await request(operator, "GET", `/campaigns/${id}/tables/trials.csv`)).text);
  assert.equal(csv.length, NUM_TRIALS);
  for (const trial of trials) {
    const verdict = scored.get(trial.number);
    assert.equal(trial.attempts.length, 1);
    const [{ scores, verdict: counted, by, outcome }] = trial.attempts;
    assert.deepEqual([counted, by, scores.map(({ scorer, verdict }) => [scorer, verdict])], [verdict, "olga", [["ada", verdict]]]);
    const row = csv.find((row) => Number(row.trial) === trial.number);
    const expected = [trial.policy, trial.object, verdict, `ada: ${verdict}`, outcome.suggested ?? ""];
    assert.deepEqual([row.policy, row.object, row.verdict, row.scores, row.suggested], expected);
  }
  // The tables count the same verdicts.
  const results = await document(`/campaigns/${id}/results`);
  const table = rows((await request(operator, "GET", `/campaigns/${id}/tables/results.csv`)).text);
  for (const policy of results.policies) {
    for (const { object, rate, failures, void: voided } of policy.objects) {
      const own = csv.filter((row) => row.policy === policy.policy && row.object === object).map((row) => row.verdict);
      const count = (verdict) => own.filter((given) => given === verdict).length;
      const wanted = [own.length - count("void"), count("success"), count("EG"), count("SL"), count("ES"), count("void")];
      assert.equal(own.length, numStarts);
      assert.deepEqual([rate.trials, rate.successes, failures.EG, failures.SL, failures.ES, voided], wanted);
      const row = table.find((row) => row.policy === policy.policy && row.object === object);
      assert.deepEqual([row.trials, row.successes, row.EG, row.SL, row.ES, row.void].map(Number), wanted);
    }
  }
  writeFileSync(scoredFile, JSON.stringify([...scored].map(([trial, verdict]) => ({ trial, verdict }))));
});

// Chromium logs what the steps above had refused on purpose.
const refusals = /status of (403|409)/;
for (const [who, on] of Object.entries(everybody)) {
  assert.deepEqual(on.errors.filter((error) => !refusals.test(error)), [], `the page of the ${who} logged errors`);
}
await browser.close();
