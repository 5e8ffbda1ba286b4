import http from "node:http";
import { openBrowser } from "./browser.mjs";
const { context, page, errors } = await openBrowser();
const button = (name) => page.getByRole("button", { name, exact: true });
const names = async () => page.evaluate(() => [...document.querySelectorAll("[role=button],[role=tab],[role=link],[role=heading],a,button")].map(e => (e.getAttribute("role")||e.tagName)+": "+(e.getAttribute("aria-label")||e.textContent||"").slice(0,90)).join("\n"));
const texts = async () => page.evaluate(() => [...document.querySelectorAll("*")].filter(e=>e.children.length===0).map(e => (e.getAttribute("aria-label")||e.textContent||"").trim()).filter(Boolean).join(" | ").slice(0,6000));
http.createServer(async (req, res) => {
  let body = ""; for await (const c of req) body += c;
  try {
    const f = new Function("page","button","names","texts","shot","errors","context", `return (async()=>{${body}})()`);
    const out = await f(page, button, names, texts, (n) => page.screenshot({ path: `/tmp/tour/${n}.png` }), errors, context);
    res.end((typeof out === "string" ? out : JSON.stringify(out)) + "\n");
  } catch (e) { res.end("ERR " + e.message.slice(0, 1500) + "\n"); }
}).listen(9555);
