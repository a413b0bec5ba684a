"""CLUSTER.toml: what is to be done, where it goes, and what works on it."""

import tomllib
from dataclasses import dataclass, field, fields
from pathlib import Path

from .errors import NeverError

FORMAT = "boresight-cluster/1"


@dataclass(frozen=True)
class Work:
    """Either `dataset` or `command` and `items`."""

    to: str = ""
    dataset: str = ""
    command: str = ""
    items: str = ""
    threads: int = 1  # of the program, for one shard or item


@dataclass(frozen=True)
class StoreTable:
    """An S3 server that is not Amazon's; credentials come from the environment alone."""

    endpoint: str = ""


@dataclass(frozen=True)
class Slurm:
    """What is asked of Slurm; empty: its own default."""

    partition: str = ""
    account: str = ""
    qos: str = ""
    nodes_per_block: int = 1
    max_blocks: int = 1
    walltime: str = "01:00:00"
    worker_init: str = ""  # shell lines before the work, on every node
    scheduler_options: str = ""  # further lines of #SBATCH
    exclusive: bool = False  # whole nodes
    max_tasks: int = 1000  # of a printed array: MaxArraySize is 1001 unless a site raised it


@dataclass(frozen=True)
class Kubernetes:
    """What is asked of Kubernetes; `image` has this package and the program in it."""

    image: str = ""
    namespace: str = "default"
    max_blocks: int = 10  # pods at a time
    cpu: int = 1
    memory: str = "1Gi"
    secret: str = ""  # a Secret whose keys become the environment: AWS_ACCESS_KEY_ID …


@dataclass(frozen=True)
class Engine:
    """What works."""

    kind: str = "local"  # local, slurm or kubernetes
    workers: int = 1  # on each node
    window: int = 4  # tasks in flight for each worker
    tries: int = 5
    patience_s: int = 0  # without a sign of work for so long, the driver begins anew; 60, and 540 on Slurm, if absent
    scratch: str = ""  # the system's folder for temporary files if empty
    slurm: Slurm = field(default_factory=Slurm)
    kubernetes: Kubernetes = field(default_factory=Kubernetes)


@dataclass(frozen=True)
class Cluster:
    """The file."""

    path: Path
    work: Work
    store: StoreTable
    engine: Engine

    def beside(self, name: str) -> Path:
        """A path of the file, which counts from the folder of the file."""
        return (self.path.parent / name).resolve()


def _table(kind: type, given: object, path: Path, at: str):
    """A table as its class; a key or a type that the class does not know is refused by name."""
    if not isinstance(given, dict):
        raise NeverError(f"{path}: {at or 'the file'} must be a table")
    known = {own.name: own for own in fields(kind)}
    values = {}
    for key, value in given.items():
        place = f"{at}.{key}" if at else key
        if key not in known:
            raise NeverError(f"{path}: {place} is not known; [{at}] has {', '.join(known)}")
        wanted = known[key].type
        if wanted in (Slurm, Kubernetes):
            values[key] = _table(wanted, value, path, place)
        elif type(value) is not wanted or (wanted is int and value < 1):
            words = {str: "a text in quotes", int: "a whole number from 1 on", bool: "true or false"}
            raise NeverError(f"{path}: {place} = {value!r} must be {words[wanted]}")
        else:
            values[key] = value
    return kind(**values)


def read(name: str) -> Cluster:
    """Reads CLUSTER.toml and says what is wrong with it before anything runs."""
    path = Path(name).resolve()
    try:
        text = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise NeverError(f"{name}: cannot be read ({error.strerror}); give the path of a CLUSTER.toml") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise NeverError(f"{name}: is no TOML ({error})") from error
    if text.pop("format", None) != FORMAT:
        raise NeverError(f'{name}: the first line must be format = "{FORMAT}"')
    if unknown := sorted(text.keys() - {"work", "store", "engine"}):
        raise NeverError(f"{name}: {unknown[0]} is not known; there are [work], [store] and [engine]")
    work = _table(Work, text.get("work", {}), path, "work")
    cluster = Cluster(path, work, _table(StoreTable, text.get("store", {}), path, "store"), _table(Engine, text.get("engine", {}), path, "engine"))
    if bool(work.dataset) == bool(work.command) or bool(work.command) != bool(work.items):
        raise NeverError(f'{name}: [work] needs either dataset = "RECIPE.toml" or both command = "…" and items = "FILE"')
    if not work.to:
        raise NeverError(f'{name}: [work] needs to = "DIR", or to = "s3://BUCKET/PREFIX"')
    if cluster.engine.kind not in ("local", "slurm", "kubernetes"):
        raise NeverError(f"{name}: engine.kind = {cluster.engine.kind!r} must be local, slurm or kubernetes")
    for wanted in filter(None, [work.dataset, work.items]):
        if not cluster.beside(wanted).is_file():
            raise NeverError(f"{name}: {cluster.beside(wanted)} is not there; paths count from the folder of {path.name}")
    return cluster
