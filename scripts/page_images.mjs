// Takes the pictures of pages in the README with a headless Chromium, and ffmpeg for the animation.
//
//   node --experimental-websocket scripts/page_images.mjs RUN GATE [FOLDER]
//
// RUN and GATE are folders of a run and of a gate; FOLDER is docs/images by default. The explorer is exported with `robogate` of the PATH.
// Node 22 and later need no flag.
import { execFileSync, spawn } from "node:child_process";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join, resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [run, gate, folder = "docs/images"] = process.argv.slice(2).map((path) => resolve(path));
if (!run || !gate) {
  console.error("usage: node --experimental-websocket scripts/page_images.mjs RUN GATE [FOLDER]");
  process.exit(2);
}
/** Frames per second of the animation, and seconds of an episode per second of it. */
const FPS = 10, SPEED = 1.5, HOLD = 12;
const temporary = mkdtempSync(join(tmpdir(), "page-images-"));

/** A browser with one page. */
async function browser() {
  const options = ["--headless", "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-sync", "--disable-component-update", "--hide-scrollbars"];
  const graphics = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--remote-debugging-port=0", `--user-data-dir=${join(temporary, "profile")}`];
  const child = spawn("chromium", [...options, ...graphics, "about:blank"], { stdio: ["ignore", "ignore", "pipe"] });
  const address = await new Promise((done) => {
    let text = "";
    child.stderr.on("data", (part) => {
      text += part;
      const found = /listening on (ws:\S+)/.exec(text);
      if (found) done(found[1]);
    });
  });
  const socket = new WebSocket(address);
  await new Promise((done) => { socket.onopen = done; });
  const waiting = new Map();
  let last = 0, session;
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    waiting.get(message.id)?.(message);
    waiting.delete(message.id);
  };
  const call = (method, params = {}) => new Promise((done, fail) => {
    const id = (last += 1);
    waiting.set(id, (message) => (message.error ? fail(new Error(`${method}: ${message.error.message}`)) : done(message.result)));
    socket.send(JSON.stringify({ id, method, params, ...(session ? { sessionId: session } : {}) }));
  });
  const { targetId } = await call("Target.createTarget", { url: "about:blank" });
  session = (await call("Target.attachToTarget", { targetId, flatten: true })).sessionId;
  for (const domain of ["Runtime", "Page"]) await call(`${domain}.enable`);
  await call("Emulation.setEmulatedMedia", { features: [{ name: "prefers-color-scheme", value: "light" }] });
  const evaluate = async (expression) => (await call("Runtime.evaluate", { expression, awaitPromise: true, returnByValue: true })).result.value;
  const wait = async (condition) => {
    for (let i = 0; (await evaluate(condition)) !== true; i++) {
      if (i > 600) throw new Error(`${condition} did not become true`);
      await new Promise((done) => setTimeout(done, 100));
    }
  };
  return {
    evaluate, wait,
    async open(file, width, height) {
      await call("Emulation.setDeviceMetricsOverride", { width, height, deviceScaleFactor: 1, mobile: false });
      await call("Page.navigate", { url: pathToFileURL(file).href });
      await wait("document.readyState === 'complete'");
    },
    /** A picture of this part of the page. */
    async picture(clip, format = "png") {
      const { data } = await call("Page.captureScreenshot", { format, clip: { scale: 1, ...clip }, ...(format === "jpeg" ? { quality: 88 } : {}) });
      return Buffer.from(data, "base64");
    },
    close() {
      socket.close();
      child.kill();
    },
  };
}

/** The place of an element on its page. */
const box = (selector) => `(() => { const b = document.querySelector(${JSON.stringify(selector)}).getBoundingClientRect(); return { x: b.x + scrollX, y: b.y + scrollY, width: b.width, height: b.height } })()`;

const page = await browser();
try {
  await page.open(join(gate, "report.html"), 1140, 1000);
  const verdict = await page.evaluate(box(".verdict"));
  writeFileSync(join(folder, "verdict.png"), await page.picture({ x: 0, y: 0, width: 1140, height: Math.round(verdict.y + verdict.height + 20) }));

  // A failure of the list, beside its passing twin, at its own speed.
  await page.open(join(run, "report.html"), 1280, 2600);
  await page.wait("!!document.querySelector('[data-ready]')");
  const choice = "[...document.querySelectorAll('button[data-second]')].find((one) => one.textContent.includes('grip loss')) ?? document.querySelector('button[data-second]')";
  await page.evaluate(`(${choice}).click()`);
  await page.wait(`(${choice}).dataset.first === document.querySelector('[data-ready]').dataset.ready`);
  const [stage, strip] = [await page.evaluate(box(".view-stage")), await page.evaluate(box(".view-strip"))];
  // The legend between picture and chart is left out of the animation.
  const slider = "document.querySelector('.view-bar input[type=range]')";
  const end = Number(await page.evaluate(`Number(${slider}.max)`));
  const frames = Math.ceil((end / SPEED) * FPS);
  mkdirSync(join(temporary, "frames"));
  for (let i = 0; i < frames + HOLD; i++) {
    await page.evaluate(`new Promise((done) => { ${slider}.value = ${Math.min(end, (i * SPEED) / FPS)}; ${slider}.dispatchEvent(new Event("input")); requestAnimationFrame(() => requestAnimationFrame(done)); })`);
    const clip = { x: stage.x, y: stage.y, width: stage.width, height: strip.y + strip.height - stage.y };
    writeFileSync(join(temporary, "frames", `${String(i).padStart(4, "0")}.png`), await page.picture(clip));
  }
  const palette = "scale=720:-1:flags=lanczos,split[a][b];[a]palettegen=max_colors=96:stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4:diff_mode=rectangle";
  execFileSync("ffmpeg", ["-v", "error", "-y", "-framerate", String(FPS), "-i", join(temporary, "frames", "%04d.png"), "-filter_complex", palette, join(folder, "twin.gif")]);

  const explorer = join(temporary, "explorer.html");
  execFileSync("robogate", ["view", run, "--export", explorer, "--clips", "0", "--quiet"]);
  await page.open(explorer, 1400, 1800);
  await page.wait("document.body.dataset.modelled === 'true' && !robogateExplorer.explorer.awake");
  const map = await page.evaluate(box(".x-map"));
  writeFileSync(join(folder, "explorer.jpg"), await page.picture({ x: 0, y: 0, width: 1400, height: Math.round(map.y + map.height + 16) }, "jpeg"));
} finally {
  page.close();
  await new Promise((done) => setTimeout(done, 300));
  rmSync(temporary, { recursive: true, force: true });
}
process.exit(0);
