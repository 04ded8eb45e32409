/** Frames on their way from the page to the worker, and to bytes there. */

/**
 * A frame that can be posted to a worker, with what is transferred. A video gives its current picture; a `VideoFrame` or an `ImageBitmap` is
 * given away.
 */
export async function postable(source) {
  if (source instanceof ImageBitmap || (globalThis.VideoFrame && source instanceof VideoFrame)) {
    return [source, [source]];
  }
  if (source?.data && source.width > 0) {
    const { data, width, height } = source;
    return [{ data, width, height }, []];
  }
  const isVideo = globalThis.HTMLVideoElement && source instanceof HTMLVideoElement;
  if (isVideo && !(source.readyState >= 2)) throw new Error('the video has no picture yet; wait for its event loadeddata');
  const made = isVideo && globalThis.VideoFrame ? new VideoFrame(source) : await createImageBitmap(source);
  return [made, [made]];
}

/** The size of a frame that is not larger than `maxSide` px, and has whole pixels. */
function reduced(width, height, maxSide) {
  const scale = Math.min(1, maxSide / Math.max(width, height));
  return [Math.max(1, Math.round(width * scale)), Math.max(1, Math.round(height * scale))];
}

let canvas;
let copies = true;

/** Width, height and bytes R, G, B, A of a frame that was posted, which is closed. */
export async function bytes(source, maxSide = Infinity) {
  if (source.data) {
    const { data, width, height } = source;
    if (Math.max(width, height) <= maxSide) return { width, height, data };
    const picture = await createImageBitmap(new ImageData(new Uint8ClampedArray(data), width, height));
    return bytes(picture, maxSide);
  }
  try {
    const [w, h] = [source.displayWidth ?? source.width, source.displayHeight ?? source.height];
    const [width, height] = reduced(w, h, maxSide);
    const upright = !source.rotation && !source.flip;
    if (copies && source.copyTo && upright && width === source.visibleRect.width && height === source.visibleRect.height) {
      // A copy keeps the values as they are, where a canvas may change them to hide who reads them.
      const options = { format: 'RGBA', colorSpace: 'srgb' };
      try {
        const data = new Uint8Array(4 * width * height);
        if (source.allocationSize(options) === data.length) {
          await source.copyTo(data, options);
          return { width, height, data };
        }
      } catch {
        copies = false;
      }
    }
    canvas ??= new OffscreenCanvas(width, height);
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext('2d', { willReadFrequently: true });
    context.drawImage(source, 0, 0, width, height);
    return { width, height, data: context.getImageData(0, 0, width, height).data };
  } finally {
    source.close?.();
  }
}
