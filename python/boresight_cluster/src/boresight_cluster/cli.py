"""The command boresight-cluster."""

import argparse
import json
import signal
import sys
import time

from . import __version__, config, scripts
from .errors import DONE, FAILED, NO, ClusterError
from .processes import beating, orphans
from .work import Job, open_job


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _share(text: str) -> tuple[int, int]:
    part, _, parts = text.partition("/")
    if not (part.isdigit() and parts.isdigit() and int(part) < int(parts)):
        raise argparse.ArgumentTypeError("give I/N with I from 0 to N - 1, as 0/5: the first of five parts")
    return int(part), int(parts)


def _progress(job: Job, units: int):
    """A line on stderr, at most one a second (every ten where it is no terminal), and the last one in any case."""
    begun, every, last = time.monotonic(), 1.0 if sys.stderr.isatty() else 10.0, [0.0]

    def say(done: int, failed: int) -> None:
        now = time.monotonic()
        if now - last[0] < every and done + failed < units:
            return
        last[0] = now
        rate = (done + failed) / max(now - begun, 1e-3)
        frames = f", {done * job.frames_of_unit / max(now - begun, 1e-3):.1f} frames/s" if job.frames_of_unit else ""
        _say(f"note: {done} of {units} done, {failed} failed{frames}, {(units - done - failed) / max(rate, 1e-9):.0f} s left")

    return say


def run(args: argparse.Namespace) -> int:
    """Makes what is missing, and finishes the whole."""
    from . import engine

    job = open_job(config.read(args.cluster))
    job.begin()
    missing = job.missing()
    _say(f"note: {len(job.units) - len(missing)} of {len(job.units)} are there, {len(missing)} to do, into {job.store}")
    failed = engine.run(job, missing, _progress(job, len(missing))) if missing else {}
    # What counts is what is at the target: a task may have been told lost after its mark was put, or another driver may have done it.
    missing = job.missing()
    notes = job.failures()
    for unit in missing:
        _say(f"error: {unit.name}: {notes.get(unit.name) or failed.get(unit.name) or 'its mark is gone'}")
    if missing:
        _say(f"error: {len(missing)} of {len(job.units)} are not done; mend what is named above and run the same command again")
        return FAILED
    wrong = job.finish()
    for sentence in wrong:
        _say(f"error: {sentence}")
    if not wrong:
        print(f"{job.store}: {len(job.units)} of {len(job.units)} done")
    return FAILED if wrong else DONE


def shard(args: argparse.Namespace) -> int:
    """Makes a share."""
    with beating():
        return open_job(config.read(args.cluster)).share(*args.shard, lambda text: _say(f"error: {text}"))


def status(args: argparse.Namespace) -> int:
    """Tells what is done, missing and failed."""
    cluster = config.read(args.cluster)
    job = open_job(cluster)
    job.begin()
    missing, failures = job.missing(), job.failures()
    wrong, left = job.damaged(args.check), orphans(cluster)
    failed = {unit.name: failures[unit.name] for unit in missing if unit.name in failures}
    if args.json:
        told = {"format": "boresight-cluster-status/1", "to": str(job.store), "units": len(job.units), "missing": [unit.name for unit in missing]}
        print(json.dumps(told | {"failed": failed, "damaged": wrong, "orphans": left}))
    else:
        print(f"{job.store}: {len(job.units) - len(missing)} of {len(job.units)} done, {len(missing)} missing, of which {len(failed)} failed")
        for name, message in failed.items():
            print(f"failed: {name}: {message}")
        for sentence in wrong:
            print(f"damaged: {sentence}")
        for sentence in left:
            print(f"orphan: {sentence}; most end by themselves within a minute, kill ends it now")
    return NO if missing or wrong else DONE


def printed(args: argparse.Namespace) -> int:
    """Prints an array script or a manifest."""
    job = open_job(config.read(args.cluster))
    job.begin()
    missing = job.missing()
    if not missing:
        _say("note: nothing is missing, so there is nothing to submit")
        return DONE
    sys.stdout.write(args.print(job, missing))
    return DONE


def parser() -> argparse.ArgumentParser:
    """The command line."""
    top = argparse.ArgumentParser(
        prog="boresight-cluster", description=__doc__, epilog="Exit codes: 0 done, 1 failed, 2 wrong usage, 3 something is missing (status)."
    )
    top.add_argument("--version", action="version", version=__version__)
    verbs = top.add_subparsers(required=True, metavar="VERB")
    for name, function, help in (
        ("run", run, "make what is missing at the target, and finish it"),
        ("shard", shard, "make one share: what every engine calls"),
        ("status", status, "tell what is done, missing and failed"),
        ("slurm", printed, "print a Slurm array script of what is missing"),
        ("kubernetes", printed, "print a Kubernetes Indexed Job of what is missing"),
    ):
        verb = verbs.add_parser(name, help=help, description=help)
        verb.add_argument("cluster", metavar="CLUSTER.toml")
        verb.set_defaults(call=function, print=getattr(scripts, name, None))
        if name == "shard":
            verb.add_argument("--shard", type=_share, required=True, metavar="I/N", help="units whose number leaves I when divided by N")
        if name == "status":
            verb.add_argument("--check", action="store_true", help="compare the bytes of everything with its mark, and not its size alone")
            verb.add_argument("--json", action="store_true", help="print one JSON object")
    return top


def _ended(number: int, _frame) -> None:
    raise SystemExit(128 + number)


def main() -> int:
    """Runs the command line; the exit code."""
    args = parser().parse_args()
    signal.signal(signal.SIGTERM, _ended)
    try:
        return args.call(args)
    except ClusterError as error:
        _say(f"error: {error}")
        return error.code
    except ImportError as error:
        _say(f"error: {error}; pip install boresight-cluster brings what it needs")
        return FAILED
    except KeyboardInterrupt:
        return 130
