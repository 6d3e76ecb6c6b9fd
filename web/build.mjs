// Builds what the server hands out: src/hiprl/web/static.

import { build } from "esbuild";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, statSync, writeFileSync } from "node:fs";

const here = new URL(".", import.meta.url).pathname;
const out = `${here}../src/hiprl/web/static/`;
mkdirSync(out, { recursive: true });

const common = {
  bundle: true, minify: true, target: ["es2022"], loader: { ".css": "text" }, legalComments: "none", absWorkingDir: here,
};
await build({ ...common, entryPoints: ["src/player.js"], format: "iife", outfile: `${out}player.js` });
await build({ ...common, entryPoints: ["src/main.js"], external: ["/static/*"], format: "esm", outfile: `${out}hiprl.js` });
await build({ ...common, loader: {}, entryPoints: ["src/hiprl.css"], outfile: `${out}hiprl.css` });
copyFileSync(`${here}src/icon.svg`, `${out}icon.svg`);

const three = JSON.parse(readFileSync(`${here}node_modules/three/package.json`, "utf8"));
writeFileSync(`${out}NOTICES.txt`, `player.js contains three.js ${three.version}, https://threejs.org\n\n`
  + readFileSync(`${here}node_modules/three/LICENSE`, "utf8"));

let sum = 0;
for (const name of readdirSync(out).sort()) {
  const { size } = statSync(out + name);
  sum += size;
  console.log(`${String(Math.round(size / 1000)).padStart(5)} kB  ${name}`);
}
console.log(`${String(Math.round(sum / 1000)).padStart(5)} kB  in all`);
if (sum > 900_000) throw new Error("static grew over 900 kB");
