// SPDX-License-Identifier: GPL-3.0-or-later
// node motion.mjs FOLDER: prints for each character of a built playground the hash of its fixed motion here, that of
// the native engine, and the largest relative difference; then what the engine says of a damaged file.
import { readFileSync } from "node:fs";
const [, , folder] = process.argv;
const { compiled, start, unzipped } = await import(`${folder}/engine.mjs`);
const read = (name) => unzipped(new Uint8Array(readFileSync(`${folder}/${name}`)).buffer);
const module = await compiled(await read("playground.wasm.gz"));
const results = [];
const { frames, models } = JSON.parse(readFileSync(`${folder}/models.json`, "utf8"));
for (const { file, sliders, native } of models) {
  const engine = await start(module, await read(`${file}.dynamorph.gz`), sliders);
  const hash = engine.fixedMotion(frames), largest = Math.max(...native.coordinates.map(Math.abs));
  const off = Math.max(...engine.coordinates().map((x, i) => Math.abs(x - native.coordinates[i]))) / largest;
  engine.skin(true);
  const finite = engine.surface().every(Number.isFinite);
  results.push({ file, hash, native: native.hash, off, about: engine.about, finite });
}
const damaged = new Uint8Array(await read("cylinder.dynamorph.gz"));
damaged[damaged.length >> 1] ^= 1;
const refused = await start(module, damaged.buffer, []).then(() => "", (error) => error.message);
console.log(JSON.stringify({ results, refused }));
