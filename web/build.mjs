// Bundles the scripts of the pages into files that the Rust crates include: node build.mjs [--check]
import { build } from "esbuild";
import { readFile, writeFile } from "node:fs/promises";

const html = "../crates/robogate-report/src/html";
const targets = [
  ["src/replays.js", `${html}/viewer.js`],
  ["src/pairs.js", `${html}/pairs.js`],
  ["src/explorer/main.js", `${html}/explorer.js`],
  ["src/replay.js", `${html}/replay.js`],
];
const check = process.argv.includes("--check");

for (const [entry, file] of targets) {
  const { outputFiles } = await build({
    entryPoints: [entry],
    bundle: true,
    minify: true,
    write: false,
    format: "iife",
    target: ["chrome110", "firefox115", "safari16.4"],
    charset: "ascii",
    legalComments: "inline",
    logLevel: "warning",
  });
  const { text } = outputFiles[0];
  if (!check) {
    await writeFile(file, text);
  } else if ((await readFile(file, "utf8").catch(() => "")) !== text) {
    console.error(`${file} differs from a new build. Run scripts/web.sh and commit the result.`);
    process.exitCode = 1;
  }
}
