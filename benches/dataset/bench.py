"""What a labelled frame costs: bench.py BORESIGHT FOLDER [--frames N] [--satsim PYTHON] [--page FILE].

Makes the datasets of the recipes beside this file by one command each, on one thread, and tells processor time for each frame, the most memory, and
whether memory grows: its middle over the last third of the run beside that over the middle third. SatSim makes frames of the size, stars and image
of the first recipe in the same run. Processor times are those of the processes and what they started (user and system), so that other work on the
machine counts little.
"""

import argparse
import os
import re
import resource
import shutil
import statistics
import subprocess
import sys
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
# Recipe, what it has, frames for each of `--frames`, and the target in ms.
CASES = (
    ("stars-100.toml", "512², 100 stars: attitude, PSF, noise, rate, stray light, hot pixels", 1.0, 8.0),
    ("stars-385.toml", "512², 385 trailed stars, the same draws", 0.1, 15.0),
    ("wide-400.toml", "1024², 400 stars, the same draws", 0.1, 20.0),
)


def memory_mb(pid: int) -> float:
    """Memory that a process holds now."""
    try:
        return int(re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text())[1]) / 1024
    except (OSError, TypeError):
        return 0.0


def measured(command: list[str], **more) -> tuple[float, float, list[float]]:
    """Runs a command: processor seconds, most memory in MB, and memory over time."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, **more)
    held: list[float] = []

    def look() -> None:
        while process.poll() is None:
            held.append(memory_mb(process.pid))
            time.sleep(0.1)

    watcher = threading.Thread(target=look, daemon=True)
    watcher.start()
    _, told = process.communicate()
    watcher.join()
    if process.returncode:
        raise SystemExit(f"{' '.join(command)} ended with {process.returncode}: {told[-2000:]}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    held = [one for one in held if one > 0]
    return seconds, max(held, default=0.0), held


def dataset(program: str, folder: Path, name: str, frames: int) -> tuple[int, float, float, list[float], int]:
    """A recipe with so many frames, in shards as they stand there: frames, processor seconds, most memory, memory over time, bytes."""
    text = (HERE / name).read_text()
    shard = int(re.search(r"frames_per_shard = (\d+)", text)[1])
    frames = max(shard, round(frames / shard) * shard)
    (folder / name).write_text(re.sub(r"train = [\d_]+", f"train = {frames}", text))
    shutil.copy(HERE / "scene.toml", folder)
    target = folder / name.removesuffix(".toml")
    shutil.rmtree(target, ignore_errors=True)
    seconds, most, held = measured([program, "dataset", str(folder / name), "-o", str(target), "--threads", "1", "--quiet"])
    size = sum(path.stat().st_size for path in target.rglob("*") if path.is_file())
    shutil.rmtree(target)
    return frames, seconds, most, held, size


def growth(held: list[float]) -> str:
    """Memory in the middle and at the end of a run."""
    third = len(held) // 3
    if third < 5:
        return "too short to tell"
    middle, end = (statistics.median(part) for part in (held[third : 2 * third], held[2 * third :]))
    return f"{middle:.0f} → {end:.0f}"


def gauge() -> float:
    """Processor seconds of a fixed piece of work, the median of five: machines that are shared are not as fast at all hours."""

    def once() -> float:
        begun, total = time.process_time(), 0
        for number in range(2_000_000):
            total += number * number
        return time.process_time() - begun

    return statistics.median(once() for _ in range(5))


def commit(program: str) -> str:
    """Version and commit of the program."""
    return subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout.strip()


def main() -> None:
    """Prints the table, and writes it."""
    options = argparse.ArgumentParser()
    options.add_argument("program")
    options.add_argument("folder", type=Path)
    options.add_argument("--frames", type=int, default=20_000)
    options.add_argument("--satsim")
    options.add_argument("--satsim-frames", type=int, default=24)
    options.add_argument("--page", type=Path)
    asked = options.parse_args()
    folder = asked.folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    program = str(Path(asked.program).resolve())
    cpu = next((line.split(":")[1].strip() for line in open("/proc/cpuinfo") if line.startswith("model name")), "unknown processor")
    text = [
        "What a labelled frame costs (make bench-dataset)",
        "",
        f"{commit(program)}; {cpu}, one thread; seeds in the recipes of benches/dataset",
        f"load of the machine when it began: {os.getloadavg()[0]:.1f}, of {os.cpu_count()} cores; times are processor times, user and system",
        "A frame is PNG of 16 bits, labels (JSON and two tables), mask and hashes, in archives.",
        "",
        f"{'dataset':<74} {'frames':>7} {'ms CPU a frame':>15} {'target':>7} {'kB a frame':>11} {'most MB':>8}  middle → end MB",
    ]
    print("\n".join(text), flush=True)
    before = gauge()
    wrong, first = [], None
    for name, what, part, target_ms in CASES:
        frames, seconds, most, held, size = dataset(program, folder, name, round(asked.frames * part))
        each = 1e3 * seconds / frames
        first = first or each
        line = f"{what:<74} {frames:>7} {each:>15.2f} {target_ms:>7.0f} {1e-3 * size / frames:>11.0f} {most:>8.0f}  {growth(held)}"
        text.append(line)
        print(line, flush=True)
        wrong += [f"{what}: {each:.1f} ms are more than {target_ms:.0f}"] if each > target_ms else []
        wrong += [f"{what}: {most:.0f} MB are more than 300"] if most > 300 else []
    if asked.satsim:
        version = subprocess.run(
            [asked.satsim, "-c", "import importlib.metadata as m; print(m.version('satsim'))"], capture_output=True, text=True, check=True
        )
        command = [asked.satsim, str(HERE / "satsim_frames.py"), str(folder / "satsim")]
        cost = []
        for frames in (1, 1 + asked.satsim_frames):  # what the start costs is taken off
            shutil.rmtree(folder / "satsim", ignore_errors=True)
            cost.append(measured([*command, str(frames)])[0])
        each = 1e3 * (cost[1] - cost[0]) / asked.satsim_frames
        line = (
            f"{'SatSim ' + version.stdout.strip() + ': 512², 100 stars, FITS and annotations, on the CPU':<74} {asked.satsim_frames:>7} {each:>15.1f}"
        )
        ratio = f"SatSim takes {each / first:.1f} times as long for a frame as the first row (target: 20)."
        text += [line, "", ratio]
        print(f"{line}\n\n{ratio}")
        wrong += [ratio] if each < 20 * first else []
    speed = f"Speed of the machine: a loop of 2,000,000 products in Python takes {before:.2f} s before and {gauge():.2f} s after."
    text += ["", speed]
    print(f"\n{speed}")
    if asked.page:
        asked.page.write_text("\n".join(text) + "\n")
    for sentence in wrong:
        print(f"target missed: {sentence}", file=sys.stderr)
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
