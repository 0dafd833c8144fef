// Bundles the scripts of the pages into files that the Rust crates include. Cargo needs no Node.
import { build } from "esbuild";

const targets = [["src/viewer.js", "../crates/robogate-report/src/html/viewer.js"]];

for (const [entry, outfile] of targets) {
  await build({
    entryPoints: [entry],
    outfile,
    bundle: true,
    minify: true,
    format: "iife",
    target: ["chrome110", "firefox115", "safari16.4"],
    charset: "ascii",
    legalComments: "inline",
    logLevel: "warning",
  });
}
