"""Frames by SatSim, for bench.py: satsim_frames.py FOLDER FRAMES.

Size, number of stars, width of their image, exposure, drift and noise are those of stars-100.toml. All frames are one set, which costs SatSim least: drawn
per frame they would be a set each. Pixels are cut 3 × 3, as in SatSim's own examples.
"""

import os
import sys

os.environ.setdefault("CUDA_VISIBLE_DEVICES", "")
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

import numpy as np  # noqa: E402
from satsim import gen_multi  # noqa: E402

folder, frames = sys.argv[1], int(sys.argv[2])
np.random.seed(1)
field_deg = 10.0
# Stars for each magnitude and square degree, about one down to V = 8.
bins = list(range(-1, 9))
share = np.array([10.0 ** (0.5 * faint) for faint in bins[1:]])
config = {
    "version": 1,
    "sim": {
        "mode": "fftconv2p",
        "spacial_osf": 3,
        "temporal_osf": "auto",
        "padding": 20,
        "samples": 1,
        "save_jpeg": False,
        "save_movie": False,
    },
    "fpa": {
        "height": 512,
        "width": 512,
        "y_fov": field_deg,
        "x_fov": field_deg,
        "dark_current": 10,
        "gain": 1,
        "bias": 0,
        "zeropoint": 16.7,
        "a2d": {"response": "linear", "fwc": 30000, "gain": 8.0, "bias": 60},
        "noise": {"read": 5, "electronic": 0},
        "psf": {"mode": "gaussian", "eod": 0.3},
        "time": {"exposure": 0.5, "gap": 0.1},
        "num_frames": frames,
    },
    "background": {"stray": {"mode": "none"}, "galactic": 19},
    "geometry": {
        "stars": {
            "mode": "bins",
            "mv": {"bins": bins, "density": list(share / share.sum())},
            "motion": {"mode": "affine", "rotation": 0.0, "translation": [1.8, 1.8]},
        },
        "obs": {"mode": "list", "list": []},
    },
}
gen_multi(config, eager=True, output_dir=folder, input_dir=folder)
