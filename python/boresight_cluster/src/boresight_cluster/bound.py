"""`python -m boresight_cluster.bound COMMAND …`: becomes the command, which on Linux ends when the process that started it does.

For the middleman of Parsl, which goes on for minutes after a driver that was killed, and its workers with it.
"""

import os
import signal
import sys

from .processes import die_with_parent

if __name__ == "__main__":
    die_with_parent(signal.SIGTERM)
    os.execvp(sys.argv[1], sys.argv[1:])
