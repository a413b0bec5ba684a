"""mrcal on its own, since it may live in another Python: directions (JSON on stdin) to pixels of the camera in the file named."""
import json
import sys

import mrcal
import numpy as np

direction = np.ascontiguousarray(json.load(sys.stdin), dtype=float)
json.dump(mrcal.project(direction, *mrcal.cameramodel(sys.argv[1]).intrinsics()).tolist(), sys.stdout)
