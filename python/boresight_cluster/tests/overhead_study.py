"""What the driver costs: python overhead_study.py --page FILE [--seconds 10] [--shards 4 16] [--turns 3], by `make cluster-overhead`.

The same shards are made by as many processes of the program as the machine has cores, each with its share of them, and by `boresight-cluster run` with
as many workers. The two take turns, so that other work on the machine meets both. Few shards and many tell apart what a run costs once (its start and its
end) and what each shard costs.
"""

import argparse
import os
import re
import shutil
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import kit

ROOT = Path(__file__).resolve().parents[3]


def recipe(folder: Path, frames_per_shard: int, shards: int) -> None:
    """The recipe of the tests with so many frames, all in one split."""
    kit.recipe(folder)
    text = re.sub(r"frames = \{.*\}", f"frames = {{ train = {frames_per_shard * shards} }}", kit.RECIPE)
    text = re.sub(r"frames_per_shard = \d+", f"frames_per_shard = {frames_per_shard}", text)
    text = re.sub(r"\[cameras\].*?(?=\[\[draw)", "[cameras]\ntrain = 2\n", text, flags=re.DOTALL)
    (folder / "recipe.toml").write_text(text)


def plain(folder: Path, processes: int) -> float:
    """Seconds that it takes so many processes of the program, by the clock."""
    begun = time.monotonic()
    command = [kit.program(), "dataset", "recipe.toml", "-o", "plain", "--threads", "1", "--quiet"]
    running = [subprocess.Popen([*command, "--shard", f"{part}/{processes}"], cwd=folder, stdout=subprocess.DEVNULL) for part in range(processes)]
    if any(process.wait() for process in running):
        raise SystemExit("a process of the program failed")
    return time.monotonic() - begun


def driven(folder: Path, workers: int) -> float:
    """Seconds that it takes the driver, by the clock."""
    (folder / "scratch").mkdir(exist_ok=True)
    path = kit.cluster(folder, "driven", workers=workers)
    begun = time.monotonic()
    code, _, err = kit.ran(path)
    if code:
        raise SystemExit(f"boresight-cluster ended with {code}: {err[-2000:]}")
    return time.monotonic() - begun


def turn(folder: Path, frames: int, shards: int, cores: int) -> tuple[float, float]:
    """Seconds by processes and by the driver, of the same bytes."""
    folder.mkdir()
    recipe(folder, frames, shards)
    by_processes, by_driver = plain(folder, cores), driven(folder, cores)
    if kit.hashes(folder / "plain") != kit.hashes(folder / "driven"):
        raise SystemExit("the driver made other bytes")
    print(f"{shards} shards: {by_processes:.1f} s by processes, {by_driver:.1f} s by the driver", flush=True)
    shutil.rmtree(folder)
    return by_processes, by_driver


def main() -> None:
    """Measures, and writes the page."""
    options = argparse.ArgumentParser()
    options.add_argument("--page", type=Path, required=True)
    options.add_argument("--seconds", type=float, default=10.0)
    options.add_argument("--shards", type=int, nargs=2, default=[4, 16])
    options.add_argument("--turns", type=int, default=3)
    args = options.parse_args()
    cores = os.cpu_count() or 1
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as name:
        trial = Path(name) / "trial"
        trial.mkdir()
        few = 200
        recipe(trial, few, cores)
        frames = max(1, round(few * args.seconds / plain(trial, cores)))
        turns = [[turn(Path(name) / f"{number}-{shards}", frames, shards, cores) for shards in args.shards] for number in range(args.turns)]
    # What more shards take by the one and by the other; the rest of the driver's time is its start and its end.
    shares, once = [], []
    for (few_plain, few_driven), (many_plain, many_driven) in turns:
        share = (many_driven - few_driven) / (many_plain - few_plain) - 1
        shares.append(share)
        once.append(few_driven - few_plain * (1 + share))
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    few, many = args.shards
    lines = [
        "What boresight-cluster costs (make cluster-overhead)",
        "",
        f"commit {commit}; {cores} cores, load of the machine when it began {load:.1f}; {few} and {many} shards of {frames} frames, about {args.seconds:.0f} s each",
        "The same bytes are made by one process of the program a core, and by the driver with one worker a core.",
        "",
        f"turn   {few:2} shards: processes, s   driver, s   {many:2} shards: processes, s   driver, s   more by a shard   once, s",
        *[
            f"{k + 1:4}   {a[0]:24.1f}   {a[1]:9.1f}   {b[0]:24.1f}   {b[1]:9.1f}   {100 * share:13.1f} %   {start:7.1f}"
            for k, ((a, b), share, start) in enumerate(zip(turns, shares, once, strict=True))
        ],
        "",
        f"A shard takes {100 * statistics.median(shares):.1f} % more by the clock with the driver, the median of {args.turns} turns (target: 5 %); its start and end take "
        f"{statistics.median(once):.1f} s of a run.",
    ]
    args.page.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
