"""What is done: shards of a dataset, or a command for every item of a list. Both are numbered units, each with a mark that says that it is done."""

import hashlib
import json
import re
import shlex
import socket
import tarfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from .config import Cluster
from .errors import DONE, NEVER, NO, ClusterError, NeverError, last_line
from .processes import binary, call, scratch, text
from .store import Folder, chunks_of, keep, open_store, sha256_of

# What a dataset begins with, beside the files that its recipe names.
HEADS = ("dataset.json", "recipe.toml")
NOTES = ".boresight-cluster/failed/"
# Small objects of a bucket that are read at once.
READERS = 16


@dataclass(frozen=True)
class Unit:
    """What is done at once: its number, its name, the object that says it is done, and the item that it is of."""

    number: int
    name: str
    mark: str
    item: str = ""


class Job:
    """Work, its units, and where they go."""

    marks: str  # prefix of the marks
    frames_of_unit = 0

    def __init__(self, cluster: Cluster):
        self.cluster, self.store = cluster, open_store(cluster)
        self.units: list[Unit] = []

    def begin(self) -> None:
        """Makes the target known as that of this work."""

    def make(self, unit: Unit) -> None:
        """Makes a unit and puts it, its mark last."""
        raise NotImplementedError

    def finish(self) -> list[str]:
        """What is to be done when nothing is missing; what is wrong with the whole, in sentences."""
        return []

    def missing(self) -> list[Unit]:
        """Units without a mark."""
        there = self.store.names(self.marks)
        return [unit for unit in self.units if unit.mark not in there]

    def read_all(self, names: list[str]) -> dict[str, bytes | None]:
        """Small objects, several at once."""
        with ThreadPoolExecutor(READERS) as pool:
            return dict(zip(names, pool.map(self.store.read, names), strict=True))

    def damaged(self, is_thorough: bool) -> list[str]:
        """Units whose object is not what its mark says: its size or, if thorough, its bytes."""
        sizes, wrong = {}, []
        marks = self.read_all([unit.mark for unit in self.units])
        for unit in self.units:
            if (data := marks[unit.mark]) is None:
                continue
            try:
                mark = json.loads(data)
                files = {one["file"]: (one["bytes"], one["sha256"]) for one in [mark, *mark.get("tables", [])]}
            except (ValueError, KeyError, TypeError, AttributeError):
                wrong.append(f"{self.store.place(unit.mark)}: is no mark; remove it, and the unit is made anew")
                continue
            for file, (bytes_, sha256) in files.items():
                folder = file.rpartition("/")[0] + "/"
                if folder not in sizes:
                    sizes[folder] = self.store.names(folder)
                if sizes[folder].get(file) != bytes_ or (is_thorough and self.store.sha256(file) != sha256):
                    wrong.append(f"{self.store.place(file)}: is not what its mark {unit.mark} says; remove both, and it is made anew")
        return wrong

    def share(self, part: int, parts: int, say: Callable[[str], None]) -> int:
        """Makes every unit whose number leaves `part` when divided by `parts` and that is not done yet; the exit code says whether to try again."""
        worst = DONE
        self.begin()
        for unit in self.units[part::parts]:
            if self.store.read(unit.mark) is not None:
                continue
            try:
                self.make(unit)
                self.store.remove(f"{NOTES}{unit.name}.json")
            except ClusterError as error:
                say(f"{unit.name}: {error}")
                note = {"unit": unit.name, "item": unit.item, "exit_code": error.code, "message": str(error)}
                note |= {"host": socket.gethostname(), "time_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())}
                self.store.write(f"{NOTES}{unit.name}.json", json.dumps(note).encode() + b"\n")
                worst = error.code if worst in (DONE, NEVER) else worst  # what may pass goes before what never does
        return worst

    def failures(self) -> dict[str, str]:
        """Names of units with what the last try of each said."""
        notes = (self.store.read(name) for name in sorted(self.store.names(NOTES)))
        found = (json.loads(note) for note in notes if note)
        return {note["unit"]: note["message"] for note in found}


class DatasetJob(Job):
    """The shards of a recipe."""

    marks = "shards/"

    def __init__(self, cluster: Cluster):
        super().__init__(cluster)
        self.recipe = str(cluster.beside(cluster.work.dataset))
        told = call([binary(), "dataset", self.recipe, "--plan", "--json", "--quiet"])
        if told.returncode:
            raise (NeverError if told.returncode == NEVER else ClusterError)(
                f"boresight dataset --plan ended with {told.returncode}: {last_line(text(told.stderr))}"
            )
        self.description = json.loads(told.stdout)
        self.frames_of_unit = self.description["frames_per_shard"]
        self.sources = [source["file"] for source in self.description.get("sources", [])]
        for split in self.description["splits"]:
            for index in range(split["shards"]):
                name = f"{split['name']}-{index:06}"
                self.units.append(Unit(len(self.units), name, f"shards/{name}.json"))

    def begin(self) -> None:
        there = self.store.read("dataset.json")
        if there is not None:
            try:
                is_same = json.loads(there)["recipe_sha256"] == self.description["recipe_sha256"]
            except (ValueError, KeyError, TypeError):
                is_same = False
            if not is_same:
                raise NeverError(
                    f"{self.store}: holds a dataset of another recipe (or another scene, catalogue or version of the program); choose another place"
                )

    def make(self, unit: Unit) -> None:
        with scratch(self.cluster) as (folder, lock):
            made = folder / "made"
            words = [binary(), "dataset", self.recipe, "-o", str(made), "--shard", f"{unit.number}/{len(self.units)}"]
            done = call([*words, "--threads", str(self.cluster.work.threads), "--quiet"], (lock,))
            if done.returncode:
                # An answer "no" (3) is no shard, and asking again brings no other.
                kind = NeverError if done.returncode in (NEVER, NO) else ClusterError
                raise kind(f"boresight dataset ended with {done.returncode}: {last_line(text(done.stderr))}")
            if not (made / unit.mark).is_file():
                raise NeverError(f"boresight dataset made no {unit.mark}: this package and the program do not fit together; update both")
            for name in HEADS:  # first, as the program does: they say whose folder it is
                keep(self.store, name, made / name)
            for name in self.sources:  # the hash of the recipe, in dataset.json, is that of these too
                self.store.put_absent(name, made / name)
            # What else stands beside these is of the whole dataset, and a dataset of one shard has it too: `finish` makes it.
            of_shard = [path.relative_to(made).as_posix() for path in made.rglob("*") if path.is_file() and not path.name.startswith(".")]
            for name in sorted(set(of_shard) - {unit.mark, *self.sources}):
                if "/" in name:
                    keep(self.store, name, made / name)
            keep(self.store, unit.mark, made / unit.mark)

    def finish(self) -> list[str]:
        if wrong := self.damaged(False):
            return wrong
        if isinstance(self.store, Folder):
            return self._finish(self.store.path)
        with scratch(self.cluster) as (folder, _):
            likeness = folder / "whole"
            self._liken(likeness)
            if wrong := self._finish(likeness):
                return wrong
            for path in sorted(likeness.iterdir()):
                if path.is_file() and path.name not in {*HEADS, *self.sources} and not path.name.startswith("."):
                    self.store.write(path.name, path.read_bytes())
        return []

    def _finish(self, folder: Path) -> list[str]:
        """Has the program finish a folder."""
        done = call([binary(), "dataset", "finish", str(folder), "--quiet"])
        return [f"{self.store}: {last_line(text(done.stderr))}"] if done.returncode else []

    def _liken(self, folder: Path) -> None:
        """A folder like the bucket for the program to finish, which goes by marks and sizes and shows first frames: of an archive the beginning is
        fetched, and the rest is a hole."""
        marks = self.read_all([unit.mark for unit in self.units])
        starts = {name: (None, 0) for name in (*HEADS, *self.sources)}
        for mark in map(json.loads, marks.values()):
            first = 3 * mark["bytes"] // mark["frames"] + (1 << 16)
            starts |= {one["file"]: (min(first, one["bytes"]), one["bytes"]) for one in [mark, *mark.get("tables", [])]}
        for name, data in marks.items():
            _write(folder / name, data)

        def fetch(name: str) -> None:
            start, size = starts[name]
            _write(folder / name, self.store.read(name, start), size)

        with ThreadPoolExecutor(READERS) as pool:
            list(pool.map(fetch, starts))


def _write(path: Path, data: bytes | None, size: int = 0) -> None:
    """Writes a file that is longer than its data by a hole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "wb") as file:
        file.write(data or b"")
        if size:
            file.truncate(size)


class CommandJob(Job):
    """A command for every item of a list: exit codes 0 and 3 are answers. A result is one archive, so that what two drivers made is never mixed."""

    marks = "results/"

    def __init__(self, cluster: Cluster):
        super().__init__(cluster)
        self.words = shlex.split(cluster.work.command)
        if not any("{item}" in word for word in self.words):
            raise NeverError(
                f'{cluster.path}: work.command has no {{item}}; write it where the item belongs, as in "boresight diagnose {{item}} --json"'
            )
        lines = cluster.beside(cluster.work.items).read_text(encoding="utf-8").splitlines()
        for item in dict.fromkeys(line.strip() for line in lines if line.strip() and not line.startswith("#")):
            # By command and item, not by line: a list may grow in its middle.
            hash = hashlib.sha256(f"{cluster.work.command}\0{item}".encode()).hexdigest()[:12]
            name = f"{re.sub(r'[^A-Za-z0-9._]+', '-', item.rstrip('/').rpartition('/')[2]).strip('.-')[:40] or 'item'}-{hash}"
            self.units.append(Unit(len(self.units), name, f"results/{name}.json", item))

    def make(self, unit: Unit) -> None:
        with scratch(self.cluster) as (folder, lock):
            made = folder / "made"
            made.mkdir()
            words = [word.replace("{item}", unit.item).replace("{out}", str(made / "out")) for word in self.words]
            if words[0] == "boresight":
                words[0] = binary()
            done = call(words, (lock,), str(self.cluster.path.parent))
            if done.returncode not in (DONE, NO):
                kind = NeverError if done.returncode == NEVER else ClusterError
                raise kind(f"{self.words[0]} ended with {done.returncode}: {last_line(text(done.stderr))}")
            (made / "stdout").write_bytes(done.stdout)
            (made / "stderr").write_bytes(done.stderr)
            result = {"format": "boresight-cluster-result/1", "item": unit.item, "command": self.cluster.work.command, "exit_code": done.returncode}
            (made / "result.json").write_text(json.dumps(result) + "\n", encoding="utf-8")
            archive, name = folder / "made.tar", f"results/{unit.name}.tar"
            _pack(made, archive)
            if not self.store.put_absent(name, archive):  # another driver was first: its result counts
                archive.write_bytes(self.store.read(name) or b"")
            mark = folder / "mark.json"
            with tarfile.open(archive) as packed:
                result = json.load(packed.extractfile("result.json"))
            result |= {"file": name, "bytes": archive.stat().st_size, "sha256": sha256_of(chunks_of(archive))}
            mark.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
            keep(self.store, unit.mark, mark)

    def finish(self) -> list[str]:
        return self.damaged(False)


def _pack(folder: Path, archive: Path) -> None:
    """All files of a folder as an archive that tells nothing of the clock or of the user."""

    def plain(entry: tarfile.TarInfo) -> tarfile.TarInfo:
        entry.mtime = entry.uid = entry.gid = 0
        entry.uname = entry.gname = ""
        return entry

    with tarfile.open(archive, "w", format=tarfile.PAX_FORMAT) as packed:
        for path in sorted(path for path in folder.rglob("*") if path.is_file()):
            packed.add(path, path.relative_to(folder).as_posix(), filter=plain)


def open_job(cluster: Cluster) -> Job:
    """The work of CLUSTER.toml."""
    return DatasetJob(cluster) if cluster.work.dataset else CommandJob(cluster)
