"use strict";
// Opens a report and a review in Chromium, network blocked but for the review, and prints what it saw as JSON.
// Arguments: the page, the address of the review, a folder for screenshots. Packages: playwright-core, axe-core.
const { chromium } = require("playwright-core");
const { readFileSync } = require("node:fs");
const { join } = require("node:path");
const { pathToFileURL } = require("node:url");

const [page_path, review_url, folder] = process.argv.slice(2);
const axe = readFileSync(require.resolve("axe-core/axe.min.js"), "utf-8");
const seen = { problems: [], requests: [], violations: [], wide: [] };

async function open(browser, url, options, name) {
  const context = await browser.newContext({ bypassCSP: true, reducedMotion: "reduce", ...options });
  const page = await context.newPage();
  page.on("console", (message) => message.type() !== "log" && seen.problems.push(`${name}: ${message.text()}`));
  page.on("pageerror", (error) => seen.problems.push(`${name}: ${error}`));
  page.on("request", (request) => seen.requests.push(request.url()));
  await page.goto(url);
  return page;
}

async function check(page, name) {
  await page.screenshot({ path: join(folder, `${name}.png`), fullPage: true });
  const width = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
  if (width[0] > width[1]) seen.wide.push(name);
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => axe.run());
  for (const one of violations) {
    if (one.impact === "serious" || one.impact === "critical") {
      seen.violations.push(`${name}: ${one.id}: ${one.nodes[0].html.slice(0, 200)} ${one.nodes[0].failureSummary}`);
    }
  }
}

(async () => {
  const browser = await chromium.launch({
    executablePath: process.env.CHROMIUM || "/usr/bin/chromium", args: ["--no-sandbox"],
  });
  const url = pathToFileURL(page_path).href;
  for (const [name, width, colorScheme] of [
    ["wide-light", 1280, "light"], ["wide-dark", 1280, "dark"], ["narrow-light", 375, "light"], ["narrow-dark", 375, "dark"],
  ]) {
    const page = await open(browser, url, { viewport: { width, height: 800 }, colorScheme, offline: true }, name);
    await check(page, name);
  }
  const plain = await open(browser, url, { javaScriptEnabled: false, offline: true, bypassCSP: false }, "no script");
  seen.plain = await plain.locator(".finding").count();
  if (await plain.locator(".short a").count()) await plain.locator(".short a").first().click();
  seen.target = new URL(plain.url()).hash;

  if (review_url) {
    const page = await open(browser, review_url, { viewport: { width: 1280, height: 800 }, bypassCSP: false }, "review");
    await page.keyboard.press("j");
    await page.keyboard.press("n");
    await page.keyboard.type("seen from the ground");
    await page.locator(".finding").first().focus();
    await page.keyboard.press("c");
    await page.getByRole("status").getByText("confirmed").waitFor();
    await page.screenshot({ path: join(folder, "review.png") });
    seen.verdict = await page.locator(".finding .verdict").first().textContent();
    await page.reload();
    seen.decisions = await page.locator("#decisions td").allTextContents();
    await page.locator(".decide a").first().click();
    await page.locator(".editor image").waitFor();
    const box = await page.locator(".editor").boundingBox();
    await page.mouse.click(box.x + 0.1 * box.width, box.y + 0.2 * box.height);
    await page.mouse.click(box.x + 0.5 * box.width, box.y + 0.6 * box.height);
    await page.keyboard.press("Enter");
    await page.screenshot({ path: join(folder, "frame.png") });
    await page.locator("form.lines button").click();
    await page.getByRole("status").getByText("Saved").waitFor();
  }
  if (review_url) {
    const options = { javaScriptEnabled: false, bypassCSP: false };
    const page = await open(browser, review_url, options, "review without a script");
    await page.locator("button[value=dismissed]").last().click();
    await page.locator(".finding.dismissed").waitFor();
    seen.form = await page.locator(".finding .verdict").last().textContent();
  }
  await browser.close();
  console.log(JSON.stringify(seen));
})().catch((error) => { console.error(error); process.exit(1); });
