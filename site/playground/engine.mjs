// SPDX-License-Identifier: GPL-3.0-or-later
// Starts the engine: all the JavaScript that the WebAssembly needs. Node and pages use it alike.

/// The bytes of a file that may be compressed by gzip: a server may have decompressed it already.
export async function unzipped(bytes) {
  const [first, second] = new Uint8Array(bytes, 0, 2);
  if (first != 0x1f || second != 0x8b) return bytes;
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).arrayBuffer();
}

/// The compiled engine, which can be started many times.
export async function compiled(wasm) {
  try {
    return await WebAssembly.compile(wasm);
  } catch (error) {
    const lacks = "This browser lacks SIMD or exceptions in WebAssembly, which the engine needs: use a newer one";
    throw new Error(lacks, { cause: error });
  }
}

/// The engine with one soft skin; what fails throws the engine's own sentence. sliders: for each target set, with
/// keys, pairs of a slider's value and the name of the target there.
export async function start(module, model, sliders) {
  let raw;
  const view = () => new DataView(raw.memory.buffer);
  const system = {
    environ_get: () => 0,
    environ_sizes_get: (count, size) => (view().setUint32(count, 0, true), view().setUint32(size, 0, true), 0),
    emscripten_notify_memory_growth: () => {},
  };
  const imports = {};
  for (const { module: from, name } of WebAssembly.Module.imports(module))
    (imports[from] ??= {})[name] = system[name] ?? (() => { throw new Error(`The engine asked for ${name}`); });
  raw = (await WebAssembly.instantiate(module, imports)).exports;
  raw._initialize?.();
  const text = (at) => {
    const bytes = new Uint8Array(raw.memory.buffer, at);
    return new TextDecoder().decode(bytes.slice(0, bytes.indexOf(0)));
  };
  const tried = (failed) => { if (failed) throw new Error(text(raw.dm_error())); };
  const at = raw.dm_alloc(model.byteLength);
  new Uint8Array(raw.memory.buffer).set(new Uint8Array(model), at);
  const failed = raw.dm_load(at, model.byteLength);
  raw.dm_free(at);
  tried(failed);
  const about = JSON.parse(text(raw.dm_describe()));
  sliders.forEach(({ keys }, s) => keys.forEach(([value, target]) => {
    const index = about.targets.indexOf(target);
    if (index < 0) throw new Error(`The model has no target '${target}'`);
    raw.dm_add_key(s, value, index);
  }));
  // Memory may grow at any call, so views are made when they are read.
  const array = (Type, from, count) => new Type(raw.memory.buffer, from, count);
  return {
    about,
    slide: raw.dm_set_slider,
    single: raw.dm_set_single,
    skin: raw.dm_skin,
    stiffness: (factor) => tried(raw.dm_set_stiffness(factor)),
    step: (x, y, z) => tried(raw.dm_step(x, y, z)),
    poke: (eye, ray) => tried(raw.dm_poke(...eye, ...ray)),
    fixedMotion: (frames) => (tried(raw.dm_fixed_motion(frames)), text(raw.dm_hash())),
    surface: () => array(Float32Array, raw.dm_surface(), 7 * about.vertices),
    triangles: () => array(Uint32Array, raw.dm_triangles(), 3 * about.triangles),
    weights: () => array(Float64Array, raw.dm_weights(), about.targets.length),
    coordinates: () => array(Float64Array, raw.dm_coordinates(), about.coordinates),
  };
}
