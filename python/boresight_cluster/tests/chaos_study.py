"""Many runs with kills drawn from seeds: python chaos_study.py --folder DIR --page FILE [--runs 100] [--seed 1] [--jobs 3], by `make cluster-chaos`.

Every second run goes to an S3 server on loopback, the others to a folder; all have to make the bytes that one process of the program makes. What was
run already with the same package and program is not run again, so it can be stopped and gone on with. The page is written when no run is missing.
"""

import argparse
import collections
import concurrent.futures
import hashlib
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

import kit

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = ROOT / "python/boresight_cluster"


def code() -> str:
    """Hash of what is tried: the package, its tests' kit, and the program."""
    sum = hashlib.sha256(Path(kit.program()).read_bytes())
    for path in [*sorted((PACKAGE / "src").rglob("*.py")), PACKAGE / "tests/kit.py"]:
        sum.update(path.read_bytes())
    return sum.hexdigest()[:16]


def server(log: Path) -> tuple[subprocess.Popen, str]:
    """An S3 server with a bucket, and its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with open(log, "wb") as out:
        process = subprocess.Popen([sys.executable, "-m", "moto.server", "-H", "127.0.0.1", "-p", str(port)], stdout=out, stderr=out)
    for _ in range(300):
        try:
            urllib.request.urlopen(urllib.request.Request(f"http://127.0.0.1:{port}/sky", method="PUT"), timeout=5)
            return process, f"http://127.0.0.1:{port}"
        except OSError:
            time.sleep(0.1)
    raise SystemExit(f"the S3 server does not answer: {log}")


def one(seed: int, reference: dict[str, str], endpoint: str) -> dict:
    """One run."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        kit.recipe(folder)
        (folder / "scratch").mkdir()
        is_bucket = seed % 2 == 0
        prefix = f"sky/run-{seed}-{time.time_ns()}"
        exit_code, err, kills, seconds = kit.chaos(folder, f"s3://{prefix}" if is_bucket else "set", seed, endpoint if is_bucket else "")
        found = kit.objects(endpoint, prefix) if is_bucket else kit.hashes(folder / "set")
        lost, other = reference.keys() - found.keys(), [key for key in found if found[key] != reference.get(key)]
        result = {"seed": seed, "target": "bucket" if is_bucket else "folder", "kills": kills, "seconds": round(seconds, 1), "exit_code": exit_code}
        return result | {"lost": len(lost), "other": len(other), "said": " | ".join(err.splitlines()[-4:]) if exit_code else ""}


def page(results: list[dict], seed: int, commit: str) -> str:
    """The page."""
    kills = collections.Counter(kind for result in results for kind in result["kills"])
    right = [result for result in results if not (result["exit_code"] or result["lost"] or result["other"])]
    rows = []
    for target in sorted({result["target"] for result in results}, reverse=True):
        own = [result for result in results if result["target"] == target]
        same = sum(result in right for result in own)
        seconds = [result["seconds"] for result in own]
        killed = sum(len(result["kills"]) for result in own)
        rows.append(f"| {target} | {len(own)} | {killed} | {same} | {statistics.median(seconds):.0f} | {max(seconds):.0f} |")
    told = "- seed {seed}: exit code {exit_code}, {lost} objects lost, {other} other. {said}"
    wrong = [told.format(**result) for result in results if result not in right]
    last, fewest = seed + len(results) - 1, min(len(result["kills"]) for result in results)
    by_kind = ", ".join(f"{kind} {kills[kind]}" for kind in kit.KINDS)
    lines = [
        "# Kills",
        "",
        f"Written by `make cluster-chaos`; commit {commit}, seeds {seed} to {last}. A dataset of {kit.SHARDS} shards is made by",
        "`boresight-cluster run` with 4 workers on one machine, into a folder or into an S3 server on loopback, while its processes are",
        "killed by SIGKILL, of kinds and after pauses drawn from the seed. A run is right if it ends with exit code 0 and every object has the",
        "SHA-256 that it has when one process of `boresight dataset` makes all of them.",
        "",
        "| target | runs | kills | right | seconds, median | seconds, most |",
        "|---|---|---|---|---|---|",
        *rows,
        "",
        f"Right in {len(right)} of {len(results)} runs with {sum(kills.values())} kills: {by_kind}. Fewest kills in a run: {fewest}.",
        "",
        "A worker is a process of Parsl's pool, the manager the pool itself, the helper what its workers share, a task the program or the process",
        "that called it, an uploader one whose shard is made and is on its way.",
        *(["", "Not right:", "", *wrong] if wrong else []),
    ]
    return "\n".join(lines) + "\n"


def main() -> int:
    """Runs what is missing."""
    options = argparse.ArgumentParser()
    options.add_argument("--folder", type=Path, required=True)
    options.add_argument("--page", type=Path, required=True)
    options.add_argument("--runs", type=int, default=100)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--jobs", type=int, default=3)
    args = options.parse_args()
    os.environ.update(kit.CREDENTIALS)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped; the same command goes on"))
    args.folder.mkdir(parents=True, exist_ok=True)
    log, tried = args.folder / "runs.jsonl", code()
    seeds = range(args.seed, args.seed + args.runs)

    def known() -> dict[int, dict]:
        lines = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
        return {line["seed"]: line for line in lines if line["code"] == tried and line["seed"] in seeds}

    missing = [seed for seed in seeds if seed not in known()]
    with tempfile.TemporaryDirectory() as name:
        kit.recipe(Path(name))
        subprocess.run([kit.program(), "dataset", "recipe.toml", "-o", "set", "--quiet"], cwd=name, check=True, stdout=subprocess.DEVNULL)
        reference = kit.hashes(Path(name) / "set")
    s3, endpoint = server(args.folder / "server.log")
    try:
        with concurrent.futures.ThreadPoolExecutor(args.jobs) as pool, open(log, "a", encoding="utf-8") as out:
            try:
                for ended in concurrent.futures.as_completed([pool.submit(one, seed, reference, endpoint) for seed in missing]):
                    out.write(json.dumps(ended.result() | {"code": tried}) + "\n")
                    out.flush()
                    print(f"{len(known())} of {args.runs}: {ended.result()}", flush=True)
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)  # those that have begun come to their end
                raise
    finally:
        s3.terminate()
        s3.wait()
    results = [known()[seed] for seed in seeds]
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
    args.page.write_text(page(results, args.seed, commit), encoding="utf-8")
    return 0 if all(not (result["exit_code"] or result["lost"] or result["other"]) for result in results) else 1


if __name__ == "__main__":
    sys.exit(main())
