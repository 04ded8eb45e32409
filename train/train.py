"""Trains one network for a given time. The learning rate follows the clock, so that it ends annealed on any machine."""
import argparse
import copy
import math
import queue
import threading
import time

import numpy as np
import torch
import torch.nn.functional as F

import degrade
import nets
import sharp

p = argparse.ArgumentParser(description=__doc__)
p.add_argument("task", choices=nets.TASKS)
p.add_argument("--photos", nargs="*", default=[], help="folders with photographs")
p.add_argument("--drawn", type=int, default=140, help="number of procedural pictures")
p.add_argument("--cache", help="file that keeps the sharp images between runs")
p.add_argument("--minutes", type=float, default=30)
p.add_argument("--size", type=int, default=96)
p.add_argument("--batch", type=int, default=8)
p.add_argument("--fresh", type=int, default=1, help="new pairs made for each step")
p.add_argument("--keep", type=int, default=3000, help="pairs kept for use again")
p.add_argument("--lr", type=float, default=1e-3)
p.add_argument("--strength", type=float, default=0, help="weight of the local contrast in the loss")
p.add_argument("--start", help="checkpoint whose weights to start from")
p.add_argument("--out", required=True, help="checkpoint to write")
p.add_argument("--threads", type=int, default=2)
p.add_argument("--seed", type=int, default=0)
a = p.parse_args()

torch.manual_seed(a.seed)
torch.set_num_threads(a.threads)
camera = degrade.Camera(*sharp.pool(a.photos, a.drawn, cache=a.cache), a.seed + 1)
net = nets.Net(a.task)
if a.start:  # layers whose shape differs (another number of frames) begin anew
    old, new = torch.load(a.start)["weights"], net.state_dict()
    net.load_state_dict({k: old[k] if k in old and old[k].shape == v.shape else v for k, v in new.items()})
ema = copy.deepcopy(net)
opt = torch.optim.AdamW(net.parameters(), lr=a.lr, betas=(0.9, 0.99), weight_decay=1e-4)


def charbonnier(x):
    return torch.sqrt(x * x + 1e-6).mean((1, 2, 3))


def strength(x):
    """Local rms of differences over 1, 2 and 4 px."""
    x = x.mean(1, keepdim=True)
    d = [x[..., k:] - x[..., :-k] for k in (1, 2, 4)] + [x[..., k:, :] - x[..., :-k, :] for k in (1, 2, 4)]
    return [torch.sqrt(F.avg_pool2d(v * v, 8, 4) + 1e-5) for v in d]


def distance(x, want):
    e = x - want
    d = charbonnier(e) + 0.5 * (charbonnier(e[..., 1:] - e[..., :-1]) + charbonnier(e[..., 1:, :] - e[..., :-1, :]))
    if a.strength > 0:  # the mean of all sharp frames that may be behind a blurred one is itself blurred: ask for contrast as well
        d = d + a.strength * sum((p - q).abs().mean((1, 2, 3)) for p, q in zip(strength(x), strength(want))) / 6
    return d


def loss_of(given, out, want):
    """The loss relative to the distance of the input, so that strong blur, of which little can be recovered, does not dominate."""
    return (0.03 * distance(out, want) / (distance(given, want) + 0.01)).mean()


class Replay:
    """A pool of training pairs. Making a pair costs more than a step, so each is used several times, each time cropped, turned and recoloured anew."""

    def __init__(self):
        self.rng = np.random.default_rng(a.seed + 2)
        self.pairs = []

    def grow(self):
        pair = camera.pair(a.task, a.size + 32)
        if len(self.pairs) < a.keep:
            self.pairs.append(pair)
        else:
            self.pairs[self.rng.integers(a.keep)] = pair

    def batch(self):
        r = self.rng
        for _ in range(a.fresh):
            self.grow()
        out = ([], [])
        for _ in range(a.batch):
            pair = self.pairs[r.integers(len(self.pairs))]
            y, x = r.integers(0, 33, 2)
            turn, channels, back = r.random(3) < 0.5, r.permutation(3), r.random() < 0.5
            for o, v in zip(out, pair):
                v = v.reshape(-1, 3, *v.shape[1:])[:: -1 if back else 1, channels, y : y + a.size, x : x + a.size]
                v = v[:, :, ::-1] if turn[0] else v
                v = v[..., ::-1] if turn[1] else v
                v = v.swapaxes(2, 3) if turn[2] else v
                o.append(v.reshape(-1, a.size, a.size))
        return np.stack(out[0]), np.stack(out[1])


replay = Replay()
for _ in range(60):
    replay.grow()
ready = queue.Queue(4)


def feed():
    while True:
        ready.put(replay.batch())


threading.Thread(target=feed, daemon=True).start()
begin = saved = said = time.time()
step, sums = 0, np.zeros(3)
while True:
    done = (time.time() - begin) / (60 * a.minutes)
    if done >= 1:
        break
    lr = a.lr * min(1, (step + 1) / 100) * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done)))
    for g in opt.param_groups:
        g["lr"] = lr
    given, want = map(torch.from_numpy, ready.get())
    out = net(given)
    f = 3 * net.middle
    loss = loss_of(given[:, f : f + 3], out, want)
    opt.zero_grad(set_to_none=True)
    loss.backward()
    torch.nn.utils.clip_grad_norm_(net.parameters(), 0.5)
    opt.step()
    step += 1
    with torch.no_grad():
        decay = min(0.997, step / (step + 20))
        for e, v in zip(ema.parameters(), net.parameters()):
            e.lerp_(v, 1 - decay)
        sums += loss.item(), (given[:, f : f + 3] - want).square().mean().item(), (out - want).square().mean().item()
    now = time.time()
    if now - said > 60:
        n = step - getattr(feed, "at", 0)
        feed.at = step
        print(f"{(now - begin) / 60:5.1f} min, step {step}, loss {sums[0] / n:.5f}, dB in {-10 * math.log10(sums[1] / n):.2f}, out {-10 * math.log10(sums[2] / n):.2f}", flush=True)
        sums[:] = 0
        said = now
    if now - saved > 120:
        torch.save({"task": a.task, "weights": ema.state_dict(), "steps": step}, a.out)
        saved = now
torch.save({"task": a.task, "weights": ema.state_dict(), "steps": step}, a.out)
print(f"{step} steps of {a.batch} crops of {a.size} px")
