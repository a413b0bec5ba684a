#!/usr/bin/env python3
"""Other programs on the frames of benches/render/main.rs: a line `tool side stars` in, the CPU time of a frame in ms out (`-` if the tool is missing).

Scene: `stars` round Gaussians of sigma 1.2 px integrated over the pixel, magnitudes even over five, the brightest 300 000 electrons; background
20 electrons, Poisson, read noise 5 electrons, one electron a count, bias 100, 16 bits. Every tool has one thread.
"""

import os

os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")  # before numpy is loaded

import sys
import time

import numpy as np
from scipy.special import erf

SIGMA_PX, BACKGROUND_E, READ_NOISE_E, BIAS_DN = 1.2, 20.0, 5.0, 100.0
REACH_PX = 7


def sky(side: int, count: int):
    """Columns, rows and electrons of the stars."""
    random = np.random.default_rng(12345)
    x, y = random.uniform(12, side - 13, count), random.uniform(12, side - 13, count)
    return x, y, 3e5 * 10 ** (-0.4 * random.uniform(0, 5, count))


def counts(electrons, random):
    """Noise and converter, as one writes them with numpy."""
    electrons = random.poisson(electrons).astype(np.float32)
    electrons += np.float32(READ_NOISE_E) * random.standard_normal(electrons.shape, dtype=np.float32)
    electrons += np.float32(BIAS_DN)
    return np.clip(np.rint(electrons), 0, 65535).astype(np.uint16)


def numpy_frame(side, x, y, electrons, random):
    """Separable differences of erf on stamps of 15 x 15 pixels, all stars at once."""
    column, row = np.rint(x).astype(np.int64), np.rint(y).astype(np.int64)
    steps = np.arange(-REACH_PX, REACH_PX + 1)
    edges = np.arange(-REACH_PX, REACH_PX + 2) - 0.5

    def profile(place, middle):
        return 0.5 * np.diff(erf((middle[:, None] + edges - place[:, None]) / (SIGMA_PX * np.sqrt(2.0))), axis=1)

    across, down = profile(x, column), profile(y, row) * electrons[:, None]
    stamps = (down[:, :, None] * across[:, None, :]).astype(np.float32)
    places = (row[:, None] + steps)[:, :, None] * side + (column[:, None] + steps)[:, None, :]
    light = np.bincount(places.ravel(), stamps.ravel(), side * side).reshape(side, side).astype(np.float32)
    return counts(light + np.float32(BACKGROUND_E), random)


def photutils_frame(side, x, y, electrons, random):
    """make_model_image with the integrated Gaussian, its own noise functions, stamps of 15 x 15 pixels."""
    from astropy.table import QTable
    from photutils.datasets import apply_poisson_noise, make_model_image, make_noise_image
    from photutils.psf import CircularGaussianSigmaPRF

    stars = QTable({"x_0": x, "y_0": y, "flux": electrons, "sigma": np.full(len(x), SIGMA_PX)})
    size = 2 * REACH_PX + 1
    light = make_model_image((side, side), CircularGaussianSigmaPRF(sigma=SIGMA_PX), stars, model_shape=(size, size))
    noisy = apply_poisson_noise(light + BACKGROUND_E, seed=int(random.integers(1 << 30)))
    noisy += make_noise_image((side, side), distribution="gaussian", mean=BIAS_DN, stddev=READ_NOISE_E, seed=int(random.integers(1 << 30)))
    return np.clip(np.rint(noisy), 0, 65535).astype(np.uint16)


def galsim_frame(side, x, y, electrons, random):
    """drawImage of a Gaussian at its place, stamps of GalSim's own size, CCDNoise."""
    import galsim

    image = galsim.ImageF(side, side, xmin=0, ymin=0)
    profile = galsim.Gaussian(sigma=SIGMA_PX)
    for column, row, flux in zip(x, y, electrons):
        stamp = profile.withFlux(flux).drawImage(center=galsim.PositionD(column, row), scale=1.0)
        overlap = stamp.bounds & image.bounds
        image[overlap] += stamp[overlap]
    image += BACKGROUND_E
    image.addNoise(galsim.CCDNoise(galsim.BaseDeviate(int(random.integers(1 << 30)) + 1), gain=1.0, read_noise=READ_NOISE_E))
    return np.clip(np.rint(image.array + BIAS_DN), 0, 65535).astype(np.uint16)


TOOLS = {"numpy": numpy_frame, "photutils": photutils_frame, "galsim": galsim_frame}


def main() -> None:
    random = np.random.default_rng(1)
    for line in sys.stdin:
        tool, side, count = line.split()
        x, y, electrons = sky(int(side), int(count))
        try:
            begin = time.process_time()
            TOOLS[tool](int(side), x, y, electrons, random)
            print(f"{1e3 * (time.process_time() - begin):.3f}", flush=True)
        except ImportError:
            print("-", flush=True)


if __name__ == "__main__":
    main()
