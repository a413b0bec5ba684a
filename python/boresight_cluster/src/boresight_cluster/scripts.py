"""The plain adapters: a Slurm array and a Kubernetes Indexed Job of the missing units, ready to be submitted."""

import base64
import json
import re
import shlex
import sys
import tomllib
from pathlib import Path

from .config import Cluster
from .engine import command_of
from .errors import NEVER, NO, NeverError
from .work import Job, Unit

# A ConfigMap holds no more.
MAX_CONFIG_BYTES = 1_000_000


def label(cluster: Cluster) -> str:
    """A name that Slurm and Kubernetes take."""
    return "boresight-" + (re.sub(r"[^a-z0-9]+", "-", cluster.path.stem.lower()).strip("-")[:40] or "work")


def slurm(job: Job, missing: list[Unit]) -> str:
    """An array script. Slurm tries nothing again that exits with an error: what is missing afterwards is printed and submitted anew."""
    cluster, options = job.cluster, job.cluster.engine.slurm
    tasks = min(len(missing), options.max_tasks)
    lines = ["#!/bin/bash", f"#SBATCH --job-name={label(cluster)}"]
    lines.append(f"#SBATCH --array=0-{tasks - 1}%{max(1, cluster.engine.workers * options.nodes_per_block * options.max_blocks)}")
    lines += ["#SBATCH --ntasks=1", f"#SBATCH --cpus-per-task={cluster.work.threads}", f"#SBATCH --time={options.walltime}"]
    lines += ["#SBATCH --requeue", "#SBATCH --open-mode=append", f"#SBATCH --output={label(cluster)}-%a.log"]
    lines += [
        f"#SBATCH --{key}={value}" for key, value in (("partition", options.partition), ("account", options.account), ("qos", options.qos)) if value
    ]
    lines += options.scheduler_options.splitlines()
    lines.append(
        f"# {len(missing)} of {len(job.units)} are missing. When this array has ended, print and submit the script anew until nothing is missing."
    )
    lines += options.worker_init.splitlines()
    lists = [" ".join(str(unit.number) for unit in missing[task::tasks]) for task in range(tasks)]
    lines.append("units=(" + " ".join(shlex.quote(own) for own in lists) + ")")
    command = command_of(cluster, sys.executable, 0, 1).rpartition(" ")[0]
    lines += ["status=0", "for number in ${units[$SLURM_ARRAY_TASK_ID]}; do"]
    lines += [f'    {command} "$number/{len(job.units)}" || status=$?', "done", "exit $status"]
    return "\n".join(lines) + "\n"


def _named_files(path: Path, found: dict[str, Path]) -> None:
    """A TOML file, and the files beside it that its texts name, which name others in turn."""
    if path.name in found:
        if found[path.name] != path:
            raise NeverError(f"{path}: two files are called {path.name}; a ConfigMap has no folders, so rename one or put them into the image")
        return
    found[path.name] = path

    def walk(value: object) -> None:
        if isinstance(value, dict):
            for one in value.values():
                walk(one)
        elif isinstance(value, list):
            for one in value:
                walk(one)
        elif isinstance(value, str) and any(letter in value for letter in "*?") and any(path.parent.glob(value.lstrip("/"))):
            raise NeverError(f"{path}: names the files {value}, which a ConfigMap does not hold; put them into the image")
        elif isinstance(value, str) and value and len(value) < 256 and "\n" not in value and (path.parent / value).is_file():
            if "/" in value:
                raise NeverError(f"{path}: names {value}, and a ConfigMap has no folders; put it beside the file, or into the image")
            _named_files(path.parent / value, found)

    if path.suffix == ".toml":
        walk(tomllib.loads(path.read_text(encoding="utf-8")))


def _texts_and_binaries(contents: dict[str, bytes]) -> tuple[dict[str, str], dict[str, str]]:
    """What a ConfigMap has as text, and what it has in base64, as images."""
    texts, binaries = {}, {}
    for name, content in contents.items():
        try:
            texts[name] = content.decode()
        except UnicodeDecodeError:
            binaries[name] = base64.b64encode(content).decode()
    return texts, binaries


def kubernetes(job: Job, missing: list[Unit]) -> str:
    """A ConfigMap with what the work is made of, and an Indexed Job, as JSON, which kubectl takes as it takes YAML."""
    cluster, options = job.cluster, job.cluster.engine.kubernetes
    if not options.image:
        raise NeverError(f"{cluster.path}: [engine.kubernetes] needs an image that has this package and the program")
    if "://" not in cluster.work.to:
        raise NeverError(f"{cluster.path}: work.to = {cluster.work.to!r} is a folder of this machine, which pods do not see; give s3://BUCKET/PREFIX")
    named: dict[str, Path] = {}
    _named_files(cluster.path, named)
    for name in filter(None, [cluster.work.dataset, cluster.work.items]):
        _named_files(cluster.beside(name), named)
    contents = {name: path.read_bytes() for name, path in sorted(named.items())}
    contents["missing"] = "".join(f"{unit.number}\n" for unit in missing).encode()
    files, binaries = _texts_and_binaries(contents)
    if sum(len(text.encode()) for text in files.values()) + sum(map(len, binaries.values())) > MAX_CONFIG_BYTES:
        raise NeverError(f"{cluster.path}: its files are too large for a ConfigMap; put them into the image, or do the work in parts")
    number = '"$(sed -n "$((JOB_COMPLETION_INDEX + 1))p" /config/missing)/%d"' % len(job.units)
    script = f"exec python3 -m boresight_cluster shard /config/{shlex.quote(cluster.path.name)} --shard {number}"
    container = {
        "name": "boresight",
        "image": options.image,
        "command": ["/bin/sh", "-c", script],
        "resources": {"requests": {"cpu": str(options.cpu), "memory": options.memory}, "limits": {"memory": options.memory}},
        "volumeMounts": [{"name": "config", "mountPath": "/config"}],
    }
    if options.secret:
        container["envFrom"] = [{"secretRef": {"name": options.secret}}]
    never = {"containerName": "boresight", "operator": "In", "values": [NEVER, NO]}
    metadata = {"name": label(cluster), "namespace": options.namespace}
    pods = {"restartPolicy": "Never", "containers": [container], "volumes": [{"name": "config", "configMap": {"name": label(cluster)}}]}
    spec = {
        "completionMode": "Indexed",
        "completions": len(missing),
        "parallelism": min(len(missing), options.max_blocks),
        "backoffLimitPerIndex": cluster.engine.tries - 1,
        "maxFailedIndexes": len(missing),
        "podFailurePolicy": {
            "rules": [
                {"action": "Ignore", "onPodConditions": [{"type": "DisruptionTarget", "status": "True"}]},
                {"action": "FailIndex", "onExitCodes": never},
            ]
        },
        "template": {"spec": pods},
    }
    items = [
        {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": files} | ({"binaryData": binaries} if binaries else {}),
        {"apiVersion": "batch/v1", "kind": "Job", "metadata": metadata, "spec": spec},
    ]
    return json.dumps({"apiVersion": "v1", "kind": "List", "items": items}, indent=2) + "\n"
