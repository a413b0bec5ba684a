"""`python -m boresight_cluster.pool …`: Parsl's pool of workers, which ends when one of its threads does by a fault.

Parsl's own goes on without workers when its helper process is killed: it answers heartbeats, and its tasks never end. A pool that ends is replaced,
and its tasks are tried again.
"""

import os
import runpy
import shutil
import sys
import threading


def _end(fault) -> None:
    """Says what a thread ended by, and ends all."""
    sys.__excepthook__(fault.exc_type, fault.exc_value, fault.exc_traceback)
    sys.stderr.flush()
    os._exit(1)


if __name__ == "__main__":
    threading.excepthook = _end
    runpy.run_path(shutil.which("process_worker_pool.py"), run_name="__main__")
