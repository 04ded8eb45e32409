/** Frames of a camera or of a video, as they come. */

/** The sentence that says why the browser gives no camera. */
function why(e) {
  switch (e.name) {
    case 'NotAllowedError':
      return 'the camera may not be used: allow it in the address bar, and try again';
    case 'NotFoundError':
    case 'OverconstrainedError':
      return 'there is no camera: plug one in, or drop a clip';
    case 'NotReadableError':
      return 'the camera is used by another program: close that one, and try again';
    default:
      return `the camera cannot be opened (${e.message || e.name})`;
  }
}

/**
 * Opens a webcam as a `<video>` that plays, and its stream; the video's `srcObject` holds it. Nothing leaves the machine.
 */
export async function webcam({ width = 640, height = 480, frameRate = 30, deviceId, video } = {}) {
  if (!navigator.mediaDevices?.getUserMedia) {
    throw new Error('this page cannot use a camera: open it by https or from localhost');
  }
  const wanted = { width: { ideal: width }, height: { ideal: height }, frameRate: { ideal: frameRate } };
  if (deviceId) wanted.deviceId = { exact: deviceId };
  let stream;
  try {
    stream = await navigator.mediaDevices.getUserMedia({ video: wanted, audio: false });
  } catch (e) {
    throw new Error(why(e), { cause: e });
  }
  const shown = video ?? document.createElement('video');
  Object.assign(shown, { muted: true, playsInline: true, srcObject: stream });
  await shown.play();
  const track = stream.getVideoTracks()[0];
  return { video: shown, stream, track, fps: track.getSettings().frameRate };
}

/**
 * A test whether a video still shows the picture of a media time. A page that was busy is told of a picture when the video shows a later one
 * already, of which it will be told, too; taken for the earlier one it would seem to have moved twice as far.
 */
function showing() {
  let comparable = false;
  return (video, time) => {
    if (!globalThis.VideoFrame) return true;
    const frame = new VideoFrame(video);
    const same = Math.abs(frame.timestamp / 1e6 - time) < 1e-3;
    frame.close();
    // Where a browser's times never agree they tell nothing; all clips begin at 0.
    comparable ||= same && time > 0.01;
    return same || !comparable;
  };
}

/**
 * A test whether a picture is missing before that of a time. One that was lost on its way to the page is not counted as shown, but leaves a gap
 * between the times of its neighbours.
 */
function missing() {
  const steps = [];
  let last;
  return (time) => {
    const step = time - last;
    last = time;
    if (!(step > 0)) return false;
    // A busy page may lose most pictures, so that the usual step is among the shortest quarter.
    const usual = [...steps].sort((a, b) => a - b)[steps.length >> 2];
    steps.push(step);
    if (steps.length > 40) steps.shift();
    return step > 1.5 * usual;
  };
}

/**
 * Calls `each(video, { number, time })` for each new picture of a video. The numbers count the pictures, so that one or more which were missed are
 * a gap; the returned function ends it.
 */
export function frames(video, each) {
  let ended = false;
  let number = 0;
  if (!('requestVideoFrameCallback' in video)) {
    let last = -1;
    const look = () => {
      if (ended) return;
      if (video.readyState >= 2 && video.currentTime !== last) {
        last = video.currentTime;
        each(video, { number: ++number, time: last });
      }
      requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
    return () => (ended = true);
  }
  let first;
  let handle;
  const [shows, lost] = [showing(), missing()];
  const look = (_, { presentedFrames, mediaTime }) => {
    if (ended) return;
    first ??= presentedFrames - 1;
    // What was lost on its way moves the count of what was shown.
    if (lost(mediaTime) && presentedFrames - first === number + 1) first -= 1;
    // A video that starts again may count anew.
    number = Math.max(number + 1, presentedFrames - first);
    handle = video.requestVideoFrameCallback(look);
    if (shows(video, mediaTime)) each(video, { number, time: mediaTime });
  };
  handle = video.requestVideoFrameCallback(look);
  return () => {
    ended = true;
    video.cancelVideoFrameCallback(handle);
  };
}
