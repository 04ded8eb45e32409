// What a page written in TypeScript does with the package; it is only checked, not run.
import { Live, Tracker, cameraWords, exportCamera, exportTargets, frames, webcam, type Camera, type Unknown } from 'blindaug';
import { BlindaugPass, LayerRenderer } from 'blindaug/three';
import { PerspectiveCamera, Scene, Texture, WebGLRenderer } from 'three';

const isKnown = <T extends object>(part: T | Unknown): part is T => !('unknown' in part);

function exposureOf(camera: Camera): [number, number] | string {
  return isKnown(camera.motion_blur) ? camera.motion_blur.interval : camera.motion_blur.unknown;
}

export async function page(): Promise<void> {
  const tracker = await Tracker.create({ fps: 30, noise: 'lines', onrestart: (why) => console.log(why) });
  const { video, fps } = await webcam({ width: 640 });
  frames(video, async (picture, { number }) => {
    const tracked = await tracker.push(picture, { number });
    if (tracked) console.log(exposureOf(tracked.camera), await cameraWords(tracked.camera), tracked.times.estimate);
  });
  const last = await tracker.finish();
  if (last) for (const { name } of await exportTargets()) (await exportCamera(last.camera, name)).files.map((f) => f.bytes.length);
  const live = await Live.create({ fps, gpu: 'auto', onframe: ({ picture, by }) => (console.log(by), picture.close()) });
  live.setLook({ size: 0.5, disk: true });
  const taken: boolean = await live.push(video, { number: 1 });
  console.log(taken);
  // @ts-expect-error A frame needs a number.
  await live.push(video);
  // @ts-expect-error There is no such noise.
  await Tracker.create({ noise: 'loud' });
  const camera = new PerspectiveCamera();
  const layer = new LayerRenderer(640, 480);
  layer.render(new WebGLRenderer(), new Scene(), camera);
  const pass = new BlindaugPass({ plate: new Texture(), layer, camera });
  const applied = await live.applied();
  if (applied) await pass.setCamera(applied);
}
