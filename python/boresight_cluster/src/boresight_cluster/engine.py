"""Parsl: keeps so many tasks in flight, on this machine, on Slurm or on Kubernetes. A task is `boresight-cluster shard … --shard I/N` of one unit."""

import os
import shlex
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from .config import Cluster
from .errors import FAILED, NEVER, ClusterError, NeverError
from .processes import begin_again, last_beat, leave, run_folder
from .work import Job, Unit

# A try that ended because its worker or its node was lost costs this much of one of its own failures.
COST_OF_LOSS = 0.25
# A look at whether the run goes on, seconds.
WATCH_S = 1.0
# How often in a row the driver began anew and no task ended, in its environment.
AGAIN = "BORESIGHT_CLUSTER_AGAIN"
# So many blocks may fail one after another without a task that ended in between: more than bad luck, and few enough where no block ever starts.
MAX_LOST_BLOCKS = 10


def _provider(cluster: Cluster):
    """Where Parsl gets its workers from."""
    engine = cluster.engine
    path = f"export PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH"
    if engine.kind == "local":
        from parsl.providers import LocalProvider

        return LocalProvider(init_blocks=1, min_blocks=1, max_blocks=1, worker_init=path)
    if engine.kind == "slurm":
        from parsl.launchers import SrunLauncher
        from parsl.providers import SlurmProvider

        slurm = engine.slurm
        return SlurmProvider(
            partition=slurm.partition or None,
            account=slurm.account or None,
            qos=slurm.qos or None,
            nodes_per_block=slurm.nodes_per_block,
            cores_per_node=engine.workers * cluster.work.threads,
            init_blocks=1,
            min_blocks=0,
            max_blocks=slurm.max_blocks,
            walltime=slurm.walltime,
            worker_init=f"{path}\n{slurm.worker_init}",
            scheduler_options=slurm.scheduler_options,
            exclusive=slurm.exclusive,
            # One dead task takes neither the others nor the job with it.
            launcher=SrunLauncher(overrides="-K0 -k --cpu-bind=none"),
        )
    from parsl.providers import KubernetesProvider

    pods = engine.kubernetes
    if not pods.image:
        raise NeverError(f"{cluster.path}: [engine.kubernetes] needs an image that has this package and the program")
    return KubernetesProvider(
        image=pods.image,
        namespace=pods.namespace,
        init_blocks=1,
        max_blocks=pods.max_blocks,
        init_cpu=float(pods.cpu),
        max_cpu=float(pods.cpu),
        init_mem=pods.memory,
        max_mem=pods.memory,
    )


def _blocks(cluster: Cluster) -> int:
    engine = cluster.engine
    return {"local": 1, "slurm": engine.slurm.max_blocks * engine.slurm.nodes_per_block, "kubernetes": engine.kubernetes.max_blocks}[engine.kind]


def _few_lost(ended: Callable[[], int]):
    """Parsl's own rule ends all when the first block dies before it registers. This one gives up after blocks that fail in a row, no task ending."""
    from parsl.jobs.states import JobState

    seen = {"failed": 0, "ended": 0}

    def judge(executor, status) -> None:
        failed = sum(job.state in (JobState.FAILED, JobState.MISSING) for job in status.values())
        if ended() > seen["ended"]:
            seen.update(failed=failed, ended=ended())
        elif failed - seen["failed"] >= MAX_LOST_BLOCKS:
            executor.set_bad_state_and_fail_all(ClusterError(f"{MAX_LOST_BLOCKS} blocks of workers failed one after another"))

    return judge


def _cost(error: Exception, _record) -> float:
    """What a failed try costs; from the number of tries on there is no other."""
    from parsl.executors.high_throughput.errors import ManagerLost, WorkerLost

    if isinstance(error, (ManagerLost, WorkerLost)):
        return COST_OF_LOSS
    return 1e9 if getattr(error, "exitcode", None) == NEVER else 1.0


def command_of(cluster: Cluster, python: str, number: int, of: int) -> str:
    """The shell command of one unit."""
    return shlex.join([python, "-m", "boresight_cluster", "shard", str(cluster.path), "--shard", f"{number}/{of}"])


def run(job: Job, units: list[Unit], say: Callable[[int, int], None]) -> dict[str, str]:
    """Has units made; `say` is told how many are done and failed. Names of the failed ones with the reason of the engine."""
    import parsl
    from parsl.config import Config
    from parsl.executors import HighThroughputExecutor
    from parsl.executors.high_throughput.executor import DEFAULT_LAUNCH_CMD

    cluster, engine = job.cluster, job.cluster.engine
    is_local = engine.kind == "local"
    # Parsl looks for its own programs on PATH, where those of an environment that is not active are not.
    os.environ["PATH"] = f"{os.path.dirname(sys.executable)}{os.pathsep}{os.environ.get('PATH', '')}"
    python = "python3" if engine.kind == "kubernetes" else sys.executable
    counts, failed, lock = {"done": 0, "failed": 0}, {}, threading.Lock()
    slots = threading.BoundedSemaphore(engine.window * engine.workers * _blocks(cluster))
    with run_folder(cluster) as folder:
        executor = HighThroughputExecutor(
            label="boresight",
            address="127.0.0.1" if is_local else None,
            max_workers_per_node=engine.workers,
            cores_per_worker=1e-3 if is_local else float(cluster.work.threads),
            provider=_provider(cluster),
            heartbeat_period=2 if is_local else 15,
            heartbeat_threshold=10 if is_local else 90,
            launch_cmd=DEFAULT_LAUNCH_CMD.replace("process_worker_pool.py", f"{shlex.quote(python)} -m boresight_cluster.pool", 1),
            interchange_launch_cmd=[sys.executable, "-m", "boresight_cluster.bound", "interchange.py"],
            block_error_handler=_few_lost(lambda: counts["done"] + counts["failed"]),
        )
        config = Config(
            executors=[executor],
            retries=engine.tries - 1,
            retry_handler=_cost,
            strategy="simple",
            strategy_period=1 if is_local else 10,
            run_dir=str(folder),
            usage_tracking=0,
            initialize_logging=False,
        )
        signs = Signs(cluster, folder, executor, counts)
        # Parsl's way out may wait for what never comes, too.
        way_out = threading.Timer(_patience_s(cluster), signs.begin_again, ["Parsl does not end"])
        with parsl.load(config):
            app = parsl.bash_app(_task)

            def ended(unit: Unit, future) -> None:
                error = future.exception()
                with lock:
                    counts["failed" if error else "done"] += 1
                    if error:
                        failed[unit.name] = str(error)
                    say(counts["done"], counts["failed"])
                slots.release()

            for unit in units:
                while not slots.acquire(timeout=WATCH_S):
                    signs.look()
                signs.look()
                future = app(command_of(cluster, python, unit.number, len(job.units)))
                future.add_done_callback(lambda future, unit=unit: ended(unit, future))
            while counts["done"] + counts["failed"] < len(units):
                time.sleep(0.05)
                signs.look()
            way_out.start()
        way_out.cancel()
    return failed


def _patience_s(cluster: Cluster) -> int:
    """How long a run may go without a sign of work. A lost manager is known to be lost after some seconds, and a new one is there after some more."""
    return cluster.engine.patience_s or (60 if cluster.engine.kind == "local" else 540)


class Signs:
    """What tells that a run goes on: an interchange, tasks that end, tasks at work, blocks that are asked for or wait for their turn.

    Parsl gives back the tasks of a manager that falls silent, and of a worker that ends in the middle of a task. A worker that is killed while it takes a
    task or hands over a result takes the task with it, or the lock of the queue that all workers of its manager share, and no task ends any more. And
    whether blocks live Parsl asks its interchange, without a limit of time: where that does not answer, no lost block is replaced.
    """

    def __init__(self, cluster: Cluster, folder: Path, executor, counts: dict[str, int]):
        self.cluster, self.folder, self.executor, self.counts = cluster, folder, executor, counts
        self.seen, self.since, self.looked = (), time.monotonic(), 0.0

    def look(self) -> None:
        """At most once in so many seconds; begins the run anew where nothing more can come."""
        now = time.monotonic()
        if now - self.looked < WATCH_S:
            return
        self.looked = now
        interchange = self.executor.interchange_proc
        if interchange and interchange.poll() is not None:
            self.begin_again(f"the interchange of Parsl, through which all tasks go, ended with {interchange.returncode}")
        from parsl.jobs.states import JobState

        blocks = list(self.executor.status_facade.values())
        # A block that waits for its turn is a sign as long as Parsl asks for it: it stops where its interchange does not answer.
        asked = self.executor._last_poll_time if any(block.state == JobState.PENDING for block in blocks) else 0.0
        seen = (sum(self.counts.values()), last_beat(self.folder), len(blocks), asked)
        # Pods do not see the folder, so nothing is known of what they do.
        if seen != self.seen or self.cluster.engine.kind == "kubernetes":
            self.seen, self.since = seen, now
        elif now - self.since > _patience_s(self.cluster):
            self.begin_again(f"no sign of work for {_patience_s(self.cluster)} s")

    def begin_again(self, why: str) -> NoReturn:
        """What is missing is given to new workers, unless that was tried in vain. Parsl is not asked to end: its way out waits for answers, too."""
        times = 1 if self.counts["done"] else int(os.environ.get(AGAIN, "0")) + 1
        if self.executor.interchange_proc:  # it bears no mark in its environment
            self.executor.interchange_proc.kill()
            self.executor.interchange_proc.wait()
        if times > self.cluster.engine.tries:
            print(f"error: {why}, and no task ended {times} times in a row; look at the workers", file=sys.stderr, flush=True)
            leave(self.folder, FAILED)
        print(f"note: {why}; what is missing is given to new workers", file=sys.stderr, flush=True)
        os.environ[AGAIN] = str(times)
        begin_again(self.folder)


def _task(command: str) -> str:
    """What Parsl runs on a worker."""
    return command
