"""A small dataset, drivers, and kills: what the tests and the study of kills are made of."""

import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

SCENE = """format = "boresight-scene/1"
camera = { width_px = 64, height_px = 48, focal_length_px = 300.0 }
sky = { physics = "none" }
[[frames]]
exposure_s = 1.0
"""
SHARDS = 24
RECIPE = """format = "boresight-recipe/1"
name = "tiny"
seed = 5
scene = "sky.toml"
licence = "CC-BY-4.0"
[size]
frames = { train = 64, validation = 16, test = 16 }
frames_per_shard = 4
members = ["mask", "distance"]
[cameras]
train = 2
validation = 1
test = 1
[splits]
apart_by = ["camera"]
[[draw]]
per = "frame"
path = "frames.rate_deg_s"
ball = { radius = 0.5 }
"""
# A run that takes longer hangs.
MAX_SECONDS = 600
KINDS = ("worker", "helper", "manager", "task", "uploader")
# AWS's own names: what S3 servers for tests take.
CREDENTIALS = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_REGION": "us-east-1"}


def program() -> str:
    """The program to be tried."""
    named = os.environ.get("BORESIGHT_BINARY", "")
    assert os.access(named, os.X_OK), "let BORESIGHT_BINARY name the boresight to be tried"
    return named


def recipe(folder: Path) -> None:
    """Writes the recipe and its scene."""
    (folder / "sky.toml").write_text(SCENE)
    (folder / "recipe.toml").write_text(RECIPE)


def cluster(
    folder: Path, to: str, workers: int = 4, endpoint: str = "", tries: int = 12, work: str = 'dataset = "recipe.toml"', more: str = ""
) -> Path:
    """Writes CLUSTER.toml."""
    path = folder / "cluster.toml"
    store = f'[store]\nendpoint = "{endpoint}"\n' if endpoint else ""
    engine = f'[engine]\nkind = "local"\nworkers = {workers}\nwindow = 4\ntries = {tries}\nscratch = "scratch"\n'
    path.write_text(f'format = "boresight-cluster/1"\n[work]\n{work}\nto = "{to}"\n{store}{engine}{more}')
    return path


def hashes(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder, those of the cluster's own notes apart."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    named = {path.relative_to(folder).as_posix(): path for path in files}
    return {name: hashlib.sha256(path.read_bytes()).hexdigest() for name, path in named.items() if not name.startswith(".boresight-cluster/")}


def bucket(endpoint: str, bucket_and_prefix: str):
    """A prefix of the S3 server for tests."""
    from obstore.store import from_url

    os.environ.update(CREDENTIALS)
    return from_url(f"s3://{bucket_and_prefix}", endpoint=endpoint, client_options={"allow_http": True})


def read(endpoint: str, bucket_and_prefix: str, name: str) -> bytes:
    """An object."""
    import obstore

    return bytes(obstore.get(bucket(endpoint, bucket_and_prefix), name).bytes())


def objects(endpoint: str, bucket_and_prefix: str) -> dict[str, str]:
    """SHA-256 of every object of a prefix, those of the cluster's own notes apart."""
    import obstore

    names = [one["path"] for batch in obstore.list(bucket(endpoint, bucket_and_prefix)) for one in batch]
    named = {name: read(endpoint, bucket_and_prefix, name) for name in names if not name.startswith(".boresight-cluster/")}
    return {name: hashlib.sha256(data).hexdigest() for name, data in named.items()}


def of_shards(hashes: dict[str, str]) -> dict[str, str]:
    """What is there before the end: not the sums and what else is written of the whole."""
    whole = ("README.md", "croissant.json", "statistics.html", "SHA256SUMS")
    return {name: sum for name, sum in hashes.items() if name not in whole}


def start(path: Path, *words: str, binary: str = "") -> subprocess.Popen:
    """boresight-cluster, begun; `words`: the verb and what follows it, `run` if nothing is said."""
    verb, *rest = words or ("run",)
    environment = os.environ | CREDENTIALS | ({"BORESIGHT_BINARY": binary} if binary else {})
    command = [sys.executable, "-m", "boresight_cluster", verb, str(path), *rest]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def ran(path: Path, *words: str, binary: str = "") -> tuple[int, str, str]:
    """boresight-cluster, to its end: exit code, stdout, stderr."""
    process = start(path, *words, binary=binary)
    out, err = process.communicate(timeout=600)
    return process.returncode, out, err


def processes(run: str) -> dict[int, tuple[int, list[str]]]:
    """Processes that one driver started, by its own run folder in their environment: number, parent and command line."""
    found = {}
    for pid in map(int, filter(str.isdigit, os.listdir("/proc"))):
        try:
            if f"BORESIGHT_CLUSTER_RUN={run}".encode() not in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0"):
                continue
            words = Path(f"/proc/{pid}/cmdline").read_bytes().decode("utf-8", "replace").split("\0")
            stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            if stat[0] != "Z":
                found[pid] = (int(stat[1]), words)
        except OSError:  # it has ended
            continue
    return found


def idle_workers(driver: int, folder: Path) -> list[int]:
    """Workers of a driver's pool that have no task."""
    alive = processes(str(next((folder / ".boresight-cluster").glob(f"cluster-{driver}-*"))))
    pools = {pid for pid, (_, words) in alive.items() if "python" in words[0] and "boresight_cluster.pool" in words}
    spawned = sorted(pid for pid, (parent, words) in alive.items() if parent in pools and any("spawn_main" in word for word in words))
    busy = {parent for parent, _ in alive.values()}
    idle = [pid for pid in spawned[1:] if pid not in busy]  # the first holds what the others share
    assert idle, alive
    return idle


def interchange(driver: int, must: bool = True) -> int:
    """The process of Parsl that a driver started and all tasks go through; Parsl gives it no environment, so it is told by its parent."""
    for pid in map(int, filter(str.isdigit, os.listdir("/proc"))):
        try:
            words = Path(f"/proc/{pid}/cmdline").read_bytes()
            parent = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:  # it has ended
            continue
        if parent == driver and b"interchange" in words:
            return pid
    assert not must, f"the driver {driver} has no interchange"
    return 0


class Killer(threading.Thread):
    """Kills so many processes of a driver by SIGKILL, of kinds and after pauses drawn from a seed."""

    def __init__(self, driver: subprocess.Popen, folder: Path, seed: int, kills: int = 10):
        super().__init__(daemon=True)
        self.driver, self.folder, self.done = driver, folder, []
        self.chance = random.Random(seed)
        # Each kind once (a manager takes its workers with it, and the middleman waits ten seconds to be sure), those that are quick by chance.
        kinds = list(KINDS) + [self.chance.choice(("worker", "task", "uploader")) for _ in range(kills - len(KINDS))]
        self.chance.shuffle(kinds)
        self.kinds = kinds

    def _run(self) -> str:
        """The run folder of the driver."""
        names = (self.folder / ".boresight-cluster").glob(f"cluster-{self.driver.pid}-*")
        return str(next(names, ""))

    def _candidates(self, kind: str, run: str) -> list[int]:
        alive = processes(run)
        pools = {pid for pid, (_, words) in alive.items() if "python" in words[0] and "boresight_cluster.pool" in words}
        if kind == "manager":
            return list(pools)
        if kind in ("worker", "helper"):
            # The process that a pool starts first holds what its workers share; the others are workers.
            spawned = {pid: parent for pid, (parent, words) in alive.items() if parent in pools and any("spawn_main" in word for word in words)}
            helpers = {min(pid for pid, parent in spawned.items() if parent == pool) for pool in set(spawned.values())}
            return sorted(helpers if kind == "helper" else spawned.keys() - helpers)
        shards = {pid for pid, (_, words) in alive.items() if "boresight_cluster" in words and "shard" in words and "python" in words[0]}
        making = {parent: pid for pid, (parent, words) in alive.items() if parent in shards and "dataset" in words}
        if kind == "task":
            return [*making.values(), *making.keys()]
        # What is made, and is on its way to the target.
        made = {
            int(path.name.split("-")[2]) for path in (self.folder / "scratch").glob("boresight-cluster-*") if any(path.glob("made/shards/*.json"))
        }
        return [pid for pid in shards & made if pid not in making]

    def run(self) -> None:
        """Until all kills are done, or the driver is."""
        while not (run := self._run()) and self.driver.poll() is None:
            time.sleep(0.02)
        for kind in self.kinds:
            time.sleep(self.chance.uniform(0.0, 0.25))
            while self.driver.poll() is None:
                # One of them by chance; one that has ended in the meantime does not count.
                if (found := self._candidates(kind, run)) and _kill(self.chance.choice(sorted(found)), run):
                    self.done.append(kind)
                    break
                time.sleep(0.003)


def _kill(pid: int, run: str) -> bool:
    """SIGKILL by a handle of the process, so that no number that was given anew is hit."""
    try:
        handle = os.pidfd_open(pid)
    except OSError:
        return False
    try:
        if pid not in processes(run):
            return False
        signal.pidfd_send_signal(handle, signal.SIGKILL)
        return True
    except ProcessLookupError:
        return False
    finally:
        os.close(handle)


def chaos(folder: Path, to: str, seed: int, endpoint: str = "", kills: int = 10) -> tuple[int, str, list[str], float]:
    """One run with kills: exit code, stderr, kinds of the kills, seconds."""
    begun = time.monotonic()
    driver = start(cluster(folder, to, endpoint=endpoint))
    killer = Killer(driver, folder, seed, kills)
    killer.start()
    try:
        _, err = driver.communicate(timeout=MAX_SECONDS)
        code = driver.returncode
    except subprocess.TimeoutExpired:
        driver.terminate()
        code, err = -1, f"it hangs, and was ended after {MAX_SECONDS} s: {driver.communicate()[1]}"
    killer.join()
    return code, err, killer.done, time.monotonic() - begun


def status(path: Path, *words: str) -> tuple[int, dict]:
    """`status --json`."""
    code, out, err = ran(path, "status", "--json", *words)
    assert out, err
    return code, json.loads(out)
