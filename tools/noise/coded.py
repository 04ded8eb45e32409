"""The noise that `blindaug estimate --track` tells of footage by several video coders, frame by frame.

    coded.py make OUT [N] PHOTOGRAPH..     clips of N frames (90 without it) of a camera that pans over each photograph, and stands still, by
                                           each coder
    coded.py measure BLINDAUG CLIP..       a row for each clip
    coded.py cover BLINDAUG CLIP..         of each made clip, without the part with the card: green's noise at mid-grey with its interval,
                                           of the whole clip and as `--track` tells it of the last frame, and the changes that it tells

A made clip has a grey card of 64 px in its lower right corner, and noise of a std of 4 of 255 at mid-grey; in those called jump-, 1.6 times
that from the middle on. Measured: the noise over a grey card by the model of the whole clip; the least and most of the tracked one over its
median; in how many frames it is off that by more than 15 %; its std over time, over its mean (flicker); the frames in which a change of the noise
is told; and, of made clips, the std on the card in the frames themselves, with its flicker. `cover` holds the noise against that on the card that was cut off,
which the program has not seen. Needs numpy, pillow and ffmpeg.
"""
import json, os, subprocess, sys, tempfile
import numpy as np
from PIL import Image
from compare import inspected

SIZE, CARD = (320, 240), 64
CODERS = {
    "x264-crf18.mp4": "libx264 -crf 18", "x264-crf23.mp4": "libx264 -crf 23", "x264-crf28.mp4": "libx264 -crf 28",
    "x264-g12-b2.mp4": "libx264 -crf 22 -g 12 -bf 2", "x264-g30-b0.mp4": "libx264 -crf 20 -g 30 -bf 0",
    "x264-cbr.mp4": "libx264 -b:v 1500k -maxrate 1500k -bufsize 1500k -preset veryfast -g 15 -tune zerolatency",
    "x265-crf23.mp4": "libx265 -crf 23 -x265-params log-level=error", "mpeg4-q4.avi": "mpeg4 -q:v 4 -g 12",
    "mpeg4-q6-b2.avi": "mpeg4 -q:v 6 -bf 2 -g 15", "mjpeg-q3.avi": "mjpeg -q:v 3 -pix_fmt yuvj420p",
    "vp9-crf24.mp4": "libvpx-vp9 -crf 24 -b:v 0 -cpu-used 4", "ffv1.mkv": "ffv1 -pix_fmt bgr0",
}
# The covariances of the levels of a Laplacian pyramid that each have std 1: `total_of_levels` in blindaug.
COVARIANCE = np.array([[0.99978894, 0.15481946, 0.02422532, 0.0031789874], [0.15481946, 0.3967273, 0.1953662, 0.042550743],
                       [0.02422532, 0.1953662, 0.36394912, 0.2017897], [0.0031789874, 0.042550743, 0.2017897, 0.3631104]])
KNOTS = [0.0, 0.08, 0.18, 0.32, 0.5, 0.7, 0.88, 1.0]


def film(photograph, frames, pans, jumps, seed):
    (w, h), rng = SIZE, np.random.default_rng(seed)
    for t in range(frames):
        x = 10 + (photograph.shape[1] - w - 21) * t / frames if pans else 10
        i, f = int(x), x - int(x)
        frame = photograph[10:10 + h, i:i + w] * (1 - f) + photograph[10:10 + h, i + 1:i + 1 + w] * f
        frame[-CARD:, -CARD:] = 0.5
        std = 4 / 255 * (1.6 if jumps and t >= frames // 2 else 1) * (0.6 + 0.8 * frame)
        yield (np.clip(frame + std * rng.normal(size=frame.shape), 0, 1) * 255 + 0.5).astype(np.uint8)


def make(out, frames, photographs):
    os.makedirs(out, exist_ok=True)
    for n, path in enumerate(photographs):
        image = Image.open(path).convert("RGB")
        scale = max((SIZE[0] + frames + 20) / image.width, (SIZE[1] + 20) / image.height)
        image = image.resize((int(image.width * scale) + 1, int(image.height * scale) + 1), Image.LANCZOS)
        photograph = np.asarray(image) / 255
        for kind, pans, jumps in [("pan", True, False), ("still", False, False), ("jump-pan", True, True)]:
            values = b"".join(f.tobytes() for f in film(photograph, frames, pans, jumps, n))
            for name, coder in CODERS.items():
                words = coder.split() if "-pix_fmt" in coder else coder.split() + ["-pix_fmt", "yuv420p"]
                target = os.path.join(out, f"{os.path.splitext(os.path.basename(path))[0]}-{kind}-{name}")
                subprocess.run(["ffmpeg", "-v", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "%dx%d" % SIZE, "-r", "30", "-i", "-",
                                "-c:v", *words, target], input=values, check=True)


def over_a_card(camera, v=0.5):
    """The std of luma, of 255; None where the noise is unknown."""
    noise = camera["noise"]
    if "levels" not in noise:
        return None
    if curves := noise.get("curves"):
        std = [[sum(np.interp(v, KNOTS, k) for k in channel) ** 0.5 for channel in level["variance"]] for level in curves["levels"]]
    else:
        std = [[s * v + i for s, i in zip(level["slope"], level["intercept"])] for level in noise["levels"]]
    return 255 * np.dot([0.299, 0.587, 0.114], np.sqrt(np.einsum("ic,jc,ij->c", std, std, COVARIANCE)))


def frames_of(clip):
    """The frames of a made clip, in steps of 8 bit; empty if it has another size."""
    command = ["ffmpeg", "-v", "error", "-i", clip, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    probe = ["ffprobe", "-v", "error", "-select_streams", "v", "-show_entries", "stream=width,height", "-of", "csv=p=0", clip]
    size = subprocess.run(probe, capture_output=True, text=True).stdout.strip().strip(",")
    values = np.frombuffer(subprocess.run(command, capture_output=True).stdout, np.uint8)
    return (values if size == "%d,%d" % SIZE else values[:0]).reshape(-1, SIZE[1], SIZE[0], 3)


def on_the_card(values):
    """The std on the card of each frame of one channel."""
    return values[:, 4 - CARD:-4, 4 - CARD:-4].std((1, 2))


def measure(blindaug, clips):
    print("clip, whole clip, tracked, least, most, frames off, flicker, changes, on the card, its flicker")
    steady, flickers, changed = 0, [], 0
    for clip in clips:
        with tempfile.TemporaryDirectory() as folder:
            out = os.path.join(folder, "camera.json")
            subprocess.run([blindaug, "estimate", clip, "-o", out], check=True, capture_output=True)
            whole = over_a_card(json.load(open(out)))
            tracked = os.path.join(folder, "cameras.jsonl")
            subprocess.run([blindaug, "estimate", clip, "--track", "-o", tracked], check=True, capture_output=True)
            rows = [json.loads(line) for line in open(tracked)]
        told = np.array([over_a_card(r) or np.nan for r in rows])
        changes = [r["frame"] for r in rows if "noise" in r.get("changed", [])]
        stds = on_the_card(frames_of(clip) @ np.array([0.299, 0.587, 0.114]))
        card = f"{stds.mean():.2f}, {stds.std() / stds.mean():.3f}" if len(stds) else ""
        usual, flicker = np.nanmedian(told), np.nanstd(told) / np.nanmean(told)
        off = np.sum(~(np.abs(told / usual - 1) <= 0.15))
        steady, changed = steady + (off == 0), changed + bool(changes)
        flickers.append(flicker)
        print(f"{os.path.basename(clip)}, {whole:.2f}, {usual:.2f}, {np.nanmin(told) / usual:.2f}, {np.nanmax(told) / usual:.2f}, {off} of {len(told)}, "
              f"{flicker:.3f}, {changes}, {card}", flush=True)
    print(f"{steady} of {len(clips)} clips stay within 15 % of their median; flicker {np.mean(flickers):.3f} in the mean, {np.median(flickers):.3f} in the "
          f"median; a change is told in {changed} clips")


def cover(blindaug, clips):
    print("clip, on the card, told, low, high, covered, told of the last frame, low, high, covered, changes")
    (w, h), known, covered, errors, changed = SIZE, [0, 0], [0, 0], [[], []], 0
    for clip in clips:
        stds = on_the_card(frames_of(clip)[..., 1])
        if not len(stds):
            print(f"{os.path.basename(clip)}, no made clip")
            continue
        card, cells = stds.mean(), []
        with tempfile.TemporaryDirectory() as folder:
            rest, out = os.path.join(folder, "rest.mkv"), os.path.join(folder, "cameras")
            subprocess.run(["ffmpeg", "-v", "error", "-i", clip, "-vf", f"crop={w - CARD}:{h}:0:0", "-c:v", "ffv1", "-pix_fmt", "bgr0", rest], check=True)
            for i, options in enumerate([["-o", out + ".json"], ["--track", "-o", out + ".jsonl"]]):
                models = inspected(blindaug, rest, *options)
                models = models if isinstance(models, list) else [models]
                cells += of_middle(models[-1]["noise"], card, i, known, covered, errors)
        changes = [m["frame"] for m in models if "noise" in m.get("changed", [])]
        changed += bool(changes)
        print(", ".join([os.path.basename(clip), f"{card:.2f}", *cells, str(changes)]), flush=True)
    for i, name in [(0, "of whole clips"), (1, "of last frames")] if min(known) else []:
        print(f"{name}: {covered[i]} of {known[i]} intervals cover; the error's logarithm is {np.mean(errors[i]):.2f} in the mean, {np.median(errors[i]):.2f} in the median")
    print(f"a change is told in {changed} clips")


def of_middle(noise, card, i, known, covered, errors):
    """Green's noise at mid-grey with its interval, of 255, and whether that covers the card's; counts it in the i-th sums."""
    if "std_of_encoded_rgb" not in noise:
        return ["unknown", "", "", ""]
    middle = next(row for row in noise["std_of_encoded_rgb"] if row["luminance"] == 0.5)
    told, (low, high) = 255 * middle["std"][1], (255 * end for end in middle["interval"][1])
    holds = bool(low <= card <= high)
    known[i], covered[i] = known[i] + 1, covered[i] + holds
    # What cannot be seen counts as a fiftieth of a step.
    errors[i].append(abs(np.log(max(told, 0.02) / card)))
    return [f"{told:.2f}", f"{low:.2f}", f"{high:.2f}", "yes" if holds else "no"]


if __name__ == "__main__":
    if sys.argv[1] == "make":
        frames = [int(word) for word in sys.argv[3:4] if word.isdigit()]
        make(sys.argv[2], *(frames or [90]), sys.argv[3 + len(frames):])
    else:
        {"measure": measure, "cover": cover}[sys.argv[1]](sys.argv[2], sys.argv[3:])
