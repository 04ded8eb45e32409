/** The worker in which frames are estimated. */
import { bytes } from './frame.js';
import { load } from './module.js';

const now = () => performance.now();

/** A camera's JSON line as an object with what is beside the camera in fields of their own. */
function tracked(json, times) {
  if (!json) return null;
  const { frame, changed = [], ...camera } = JSON.parse(json);
  return { frame, changed, camera, times };
}

const answers = {
  async tracker({ fps, lines, maxSide, threads, compiled }) {
    const { FrameTracker } = await load({ threads, compiled });
    const tracker = new FrameTracker(fps, lines);
    answers.push = async ({ frame, number }) => {
      const { width, height, data } = await bytes(frame, maxSide);
      const start = now();
      const json = tracker.push(number, width, height, data);
      return tracked(json, { estimate: now() - start });
    };
    answers.finish = () => {
      const start = now();
      return tracked(tracker.finish(), { estimate: now() - start });
    };
  },
  async live(options) {
    const { live } = await import('./live-worker.js');
    Object.assign(answers, await live(options));
  },
};

let turn = Promise.resolve();

self.onmessage = ({ data: { id, what, argument } }) => {
  // One question after the other; what has no number has no answer.
  const answered = (turn = turn.then(async () => {
    try {
      const value = await answers[what](argument);
      if (id) self.postMessage({ type: 'answer', id, value });
    } catch (e) {
      // After a trap nothing in the module's memory can be relied on.
      if (e instanceof WebAssembly.RuntimeError) self.postMessage({ type: 'crash', why: e.message });
      else if (id) self.postMessage({ type: 'answer', id, error: e.message ?? String(e) });
      else self.postMessage({ type: 'trouble', why: e.message ?? String(e) });
    }
  }));
  return answered;
};
