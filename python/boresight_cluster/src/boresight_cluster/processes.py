"""The program, scratch folders, and processes whose driver is gone."""

import contextlib
import ctypes
import fcntl
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from .config import Cluster
from .errors import ClusterError

# The run that a process belongs to, in its environment.
RUN = "BORESIGHT_CLUSTER_RUN"
NAME = "boresight-cluster-"
# Loaded here: between fork and exec nothing may be.
_PRCTL = ctypes.CDLL(None).prctl if sys.platform == "linux" else None
_PR_SET_PDEATHSIG = 1
# The file in the run folder whose time every task at work sets, and how often, seconds.
BEAT, BEAT_S = "beat", 2.0


def binary() -> str:
    """The program: BORESIGHT_BINARY, else `boresight` on PATH."""
    named = os.environ.get("BORESIGHT_BINARY")
    found = shutil.which(named or "boresight")
    if not found:
        where = f"BORESIGHT_BINARY names {named}, which is no program" if named else "boresight is not on PATH"
        raise ClusterError(f"{where}; install it with cargo install, or let BORESIGHT_BINARY name it")
    return found


def die_with_parent(by: int = signal.SIGKILL) -> None:
    """Linux: this process, and what it becomes by exec, ends when the thread that started it does."""
    if _PRCTL:
        _PRCTL(_PR_SET_PDEATHSIG, int(by), 0, 0, 0)


def call(words: list[str], keep_open: tuple[int, ...] = (), folder: str | None = None) -> subprocess.CompletedProcess:
    """Runs a command to its end; it is killed if this process is."""
    try:
        return subprocess.run(words, capture_output=True, stdin=subprocess.DEVNULL, pass_fds=keep_open, cwd=folder, preexec_fn=die_with_parent)
    except OSError as error:
        raise ClusterError(f"{words[0]}: cannot be run ({error.strerror}); look at PATH") from error


def text(data: bytes) -> str:
    """Bytes of a program as text."""
    return data.decode("utf-8", "replace")


@contextlib.contextmanager
def scratch(cluster: Cluster) -> Iterator[tuple[Path, int]]:
    """A folder for one task, and the file whose lock says that it is in use. What killed tasks left beside it is removed first."""
    base = Path(cluster.beside(cluster.engine.scratch) if cluster.engine.scratch else tempfile.gettempdir())
    base.mkdir(parents=True, exist_ok=True)
    for left in base.glob(f"{NAME}*.lock"):
        with contextlib.suppress(OSError), open(left, "rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            shutil.rmtree(left.with_suffix(""), ignore_errors=True)
            left.unlink(missing_ok=True)
    while True:
        lock, name = tempfile.mkstemp(prefix=f"{NAME}{os.getpid()}-", suffix=".lock", dir=base)
        with contextlib.suppress(OSError):
            fcntl.flock(lock, fcntl.LOCK_EX)
        if os.path.exists(name):  # else it was taken for a leftover before it was locked
            break
        os.close(lock)
    folder = Path(name).with_suffix("")
    folder.mkdir()
    try:
        yield folder, lock
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.unlink(name)
        os.close(lock)


@contextlib.contextmanager
def run_folder(cluster: Cluster) -> Iterator[Path]:
    """A folder for one driver beside CLUSTER.toml (nodes have to see it); every process that it starts bears its name in the environment."""
    base = cluster.path.parent / ".boresight-cluster"
    base.mkdir(exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{cluster.path.stem}-{os.getpid()}-", dir=base))
    driver = {"pid": os.getpid(), "host": socket.gethostname(), "begun": _begun(os.getpid())}
    (folder / "driver.json").write_text(json.dumps(driver) + "\n", encoding="utf-8")
    os.environ[RUN] = str(folder)
    (folder / BEAT).touch()
    try:
        yield folder
    finally:
        _clear(folder)


def _clear(folder: Path) -> None:
    """Ends what is left of a driver's processes on this machine, and removes its folder."""
    os.environ.pop(RUN, None)
    # A pool that was killed leaves a helper behind that nothing ends.
    for pid in _processes(folder) - {os.getpid()}:
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        folder.parent.rmdir()


def begin_again(folder: Path) -> NoReturn:
    """The driver becomes a new one of the same number and command line. Nothing of Parsl is asked to end: what it waits for may never come."""
    _clear(folder)
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", __package__, *sys.argv[1:]])


def leave(folder: Path, code: int) -> NoReturn:
    """Ends the driver as `begin_again` does, without asking."""
    _clear(folder)
    sys.stdout.flush()
    os._exit(code)


@contextlib.contextmanager
def beating() -> Iterator[None]:
    """As long as it lasts, the driver can see that a task is at work, whatever became of the processes between the two."""
    path, over = Path(os.environ.get(RUN, "")) / BEAT, threading.Event()

    def beat() -> None:
        while True:
            with contextlib.suppress(OSError):  # a node or a pod that does not see the folder
                os.utime(path)
            if over.wait(BEAT_S):
                break

    if RUN in os.environ:
        threading.Thread(target=beat, daemon=True).start()
    try:
        yield
    finally:
        over.set()


def last_beat(folder: Path) -> int:
    """When a task was last seen at work, by the clock of the file system."""
    try:
        return (folder / BEAT).stat().st_mtime_ns
    except OSError:
        return 0


def _begun(pid: int) -> str:
    """When a process began, in ticks of the kernel; empty: there is no such process. Numbers of processes come again, this does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[19]
    except OSError:
        return ""


def orphans(cluster: Cluster) -> list[str]:
    """Processes of this machine whose driver is gone, in words; none where there is no /proc. Folders of drivers that have none left are removed."""
    base, found = cluster.path.parent / ".boresight-cluster", []
    if not base.is_dir() or not Path("/proc/self/environ").exists():
        return found
    for folder in sorted(base.glob(f"{cluster.path.stem}-*")):
        try:
            driver = json.loads((folder / "driver.json").read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if driver["host"] != socket.gethostname() or _begun(driver["pid"]) == driver["begun"]:
            continue
        own = _processes(folder)
        for pid in sorted(own):
            with contextlib.suppress(OSError):
                words = text(Path(f"/proc/{pid}/cmdline").read_bytes()).replace("\0", " ").strip()
                found.append(f"process {pid} of the driver {driver['pid']}, which is gone: {words[:100]}")
        if not own:
            shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        base.rmdir()
    return found


def _processes(folder: Path) -> set[int]:
    """Processes of this machine that a driver started, by its run folder in their environment; none where there is no /proc."""
    mark, found = f"{RUN}={folder}".encode(), set()
    for environment in Path("/proc").glob("[0-9]*/environ"):
        try:
            if mark in environment.read_bytes().split(b"\0"):
                found.add(int(environment.parent.name))
        except OSError:  # of another user, or it has ended
            continue
    return found
