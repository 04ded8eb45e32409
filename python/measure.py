"""What the package costs beside the program: `python measure.py PROGRAM [ROUNDS]`, of release builds, with the package installed; needs ffmpeg.

Estimates a camera from 100 frames of 1920 x 1080 px by the program, by Python from the same file, and by Python from an array in a file that is
mapped to memory, in turn, and prints the least processor time and the largest memory of each; then how long an import takes.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FRAMES, WIDTH, HEIGHT = 100, 1920, 1080


def cost(command: list[str]) -> tuple[float, float, bytes]:
    """The processor time in s, the peak of resident memory in MB, and what is printed."""
    with tempfile.TemporaryFile() as out:
        process = subprocess.Popen(command, stdout=out, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        assert process.returncode == 0, command
        out.seek(0)
        return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024, out.read()


def main(program: str, rounds: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        clip, raw = Path(folder) / "clip.mp4", Path(folder) / "clip.rgb"
        picture = f"testsrc2=size={WIDTH}x{HEIGHT}:rate=25,noise=alls=8:allf=t"
        ffmpeg = ["ffmpeg", "-y", "-loglevel", "error"]
        made = ["-frames:v", str(FRAMES), "-pix_fmt", "yuv420p", "-c:v", "libx264", "-preset", "ultrafast", "-crf", "18", str(clip)]
        subprocess.run([*ffmpeg, "-f", "lavfi", "-i", picture, *made], check=True)
        subprocess.run([*ffmpeg, "-i", str(clip), "-f", "rawvideo", "-pix_fmt", "rgb24", str(raw)], check=True)
        of_file = f"import blindaug as ba; print(ba.estimate({str(clip)!r}).to_json(), end='')"
        of_array = (
            "import blindaug as ba, numpy as np; "
            f"frames = np.memmap({str(raw)!r}, np.uint8, 'r').reshape(-1, {HEIGHT}, {WIDTH}, 3); print(ba.estimate(frames).to_json(), end='')"
        )
        ways = {
            "the program, a video": [program, "estimate", str(clip), "--json"],
            "Python, the same video": [sys.executable, "-c", of_file],
            "Python, an array": [sys.executable, "-c", of_array],
        }
        costs: dict[str, list[tuple[float, float, bytes]]] = {way: [] for way in ways}
        for _ in range(rounds):
            for way, command in ways.items():
                costs[way].append(cost(command))
        for way, of_way in costs.items():
            print(f"{way}: {min(c[0] for c in of_way):.1f} s of processor time, {max(c[1] for c in of_way):.0f} MB", flush=True)
        video = [costs[way][0][2] for way in list(ways)[:2]]
        print("the same bits" if video[0] == video[1] else "OTHER BITS")
    times = []
    for _ in range(10):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", "import blindaug"], check=True)
        imported = time.perf_counter()
        subprocess.run([sys.executable, "-c", ""], check=True)
        times.append(2 * imported - began - time.perf_counter())
    print(f"import blindaug: {1000 * min(times):.0f} ms, the least of {len(times)}")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3)
