"""`python -m boresight_cluster`: the same as the command boresight-cluster."""

import sys

from .cli import main

sys.exit(main())
