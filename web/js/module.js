/** The WebAssembly module of the thread that asks for it, loaded once. */
let loaded;
const programs = new Map();

/** Whether the build with threads is taken: more than one is asked for, and the page may share memory (its server sends COOP and COEP). */
const shares = (threads) => threads > 1 && globalThis.crossOriginIsolated === true;

/** The compiled program, which may be posted to workers, so that it is loaded and compiled once. */
export function program({ threads = 1 } = {}) {
  const folder = shares(threads) ? 'wasm-threads' : 'wasm';
  if (!programs.has(folder)) {
    const response = fetch(new URL(`../${folder}/blindaug_bg.wasm`, import.meta.url));
    const compiled = response.then(async (r) => {
      if (!r.ok) throw new Error(`${r.url} cannot be loaded (${r.status}): build it, by web/build.sh`);
      return WebAssembly.compile(await r.arrayBuffer());
    });
    // What failed once may be there later.
    compiled.catch(() => programs.delete(folder));
    programs.set(folder, compiled);
  }
  return programs.get(folder);
}

/** Loads the module, of a program if there is one already. */
export function load({ threads = 1, compiled } = {}) {
  loaded ??= (async () => {
    const module = shares(threads) ? await import('../wasm-threads/blindaug.js') : await import('../wasm/blindaug.js');
    await module.default({ module_or_path: compiled ?? (await program({ threads })) });
    if (shares(threads)) await module.initThreadPool(threads);
    return module;
  })();
  loaded.catch(() => (loaded = undefined));
  return loaded;
}
