/** A camera in words, as a file, and as settings of other tools. */
import { load } from './module.js';

const text = (camera) => (typeof camera === 'string' ? camera : JSON.stringify(camera));

/** A camera in words, a line per fact. */
export async function cameraWords(camera) {
  return (await load()).cameraWords(text(camera));
}

/** The parameters of a camera: pairs of a name and a short text, the value with its interval or the reason why it is unknown. */
export async function cameraParameters(camera) {
  return JSON.parse((await load()).cameraParameters(text(camera)));
}

/** The text of a file camera.json. */
export async function cameraFile(camera) {
  return (await load()).cameraFile(text(camera));
}

/** The tools that cameras can be exported to, and what each can do. */
export async function exportTargets() {
  return JSON.parse((await load()).exportTargets());
}

/** A camera as settings of a tool: files with their bytes, and notes on what the tool cannot do. */
export async function exportCamera(camera, target, { fov } = {}) {
  const { Exported } = await load();
  const exported = new Exported(text(camera), target, fov);
  try {
    const files = exported.names.map((name, i) => ({ name, bytes: exported.content(i) }));
    return { files, notes: exported.notes };
  } finally {
    exported.free();
  }
}

/** A tile of noise for shaders: four octaves of std 1 in R, G, B, A, finest first, each stored as 0.5 + gain x value, 8 bit. */
export async function noiseTile() {
  const module = await load();
  return { ...JSON.parse(module.noiseTileLayout()), data: module.noiseTile() };
}
