/** blindaug in the browser: see README.md. */
export { cameraFile, cameraParameters, cameraWords, exportCamera, exportTargets, noiseTile } from './camera.js';
export { frames, webcam } from './source.js';
export { Live } from './live.js';
export { Tracker } from './tracker.js';
