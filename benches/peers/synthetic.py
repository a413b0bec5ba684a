#!/usr/bin/env python3
"""Synthetic star lists with a known camera: the calibrator beside tetra3rs and the joint least squares that knows the true model.

Stars are those of the built-in catalogue, attitudes random, the noise Gaussian and known to all. The distortion of the truth is
`k1` alone, in the convention of CONVENTIONS.md, of the size of a `k1` of 0.1 or −0.15 in units of the focal length (OpenCV's),
for all programs the same. Every program starts from a focal length that is 0.5 % too long and the principal point in the middle.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is loaded: its threads only get into each other's way here

import argparse
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import peers
from camera import NAMES, Camera, Frame, joint_fit, map_error_px, starting_attitudes
from sky import lone, random_attitude, read_catalog, view

WIDTH_PX, HEIGHT_PX = 1024, 768
DECLARED_FOCAL_LENGTH = 1.005
# A star with a neighbour nearer than this would be a blend.
LONE_PX = 5.0


@dataclass(frozen=True)
class Case:
    """A camera, its nights, and how faint the stars go (chosen for the stated mean number of stars)."""

    name: str
    width_deg: float
    k1_in_focal_lengths: float
    centre_px: tuple
    sigma_px: float
    frames: int
    magnitude_limit: float

    def camera(self) -> Camera:
        f = WIDTH_PX / 2.0 / np.tan(np.radians(self.width_deg) / 2.0)
        x0, y0 = (WIDTH_PX - 1) / 2.0 + self.centre_px[0], (HEIGHT_PX - 1) / 2.0 + self.centre_px[1]
        return Camera(WIDTH_PX, HEIGHT_PX, x0, y0, f, self.k1_in_focal_lengths / f**2)

    def declared(self) -> Camera:
        f = DECLARED_FOCAL_LENGTH * self.camera().focal_length_px
        return Camera(WIDTH_PX, HEIGHT_PX, (WIDTH_PX - 1) / 2.0, (HEIGHT_PX - 1) / 2.0, f)


CASES = [
    Case("narrow: 11.4°, k1 0.1, centre (6, 5), 0.13 px, 8 frames", 11.4, 0.1, (6.0, 5.0), 0.13, 8, 7.27),  # 388 stars
    Case("wide: 25°, k1 -0.15, centre (12, -8), 0.10 px, 10 frames", 25.0, -0.15, (12.0, -8.0), 0.10, 10, 6.39),  # 814 stars
]
ORACLES = {"joint least squares, true model": NAMES[:4], "joint least squares, x0,y0,f,k1,p1,p2": NAMES}
TETRA3RS = {"tetra3rs radial": ("radial", 4), "tetra3rs polynomial 4": ("polynomial", 4), "tetra3rs polynomial 5": ("polynomial", 5)}


def make_frames(case: Case, catalog, allowed, random: np.random.Generator) -> list:
    """One set: frames of measured stars."""
    truth, frames = case.camera(), []
    for _ in range(case.frames):
        rows, pixel = view(truth, catalog, allowed, random_attitude(random))
        pixel = pixel + random.normal(0.0, case.sigma_px, pixel.shape)
        kept = (np.abs(pixel - truth.middle_px) <= np.array([WIDTH_PX, HEIGHT_PX]) / 2.0 - 1e-6).all(axis=1)
        rows, pixel = rows[kept], pixel[kept]
        sigma = np.full(len(rows), case.sigma_px)
        frames.append(Frame(catalog.hip[rows], catalog.direction[rows], pixel, sigma, catalog.magnitude[rows]))
    return frames


def errors(found, truth: Camera) -> dict:
    """How far a camera is from the truth; pulls are errors in units of their stated standard errors."""
    rms, largest = map_error_px(found.rays, truth)
    f = found.focal_length_px - truth.focal_length_px
    x, y = found.centre_px[0] - truth.x0_px, found.centre_px[1] - truth.y0_px
    pulls = {name: error / found.sigma[name] for name, error in (("f", f), ("x0", x), ("y0", y)) if name in found.sigma}
    return {"f_px": f, "centre_px": float(np.hypot(x, y)), "map_rms_px": rms, "map_max_px": largest, "seconds": found.seconds, **pulls}


def summary(sets: list) -> dict:
    """Medians over the sets that were solved; the pulls' root mean square should be 1."""
    solved = [one for one in sets if one is not None]
    if not solved:
        return {"sets": len(sets), "solved": 0}
    of = lambda key: np.array([one[key] for one in solved if key in one])
    result = {"sets": len(sets), "solved": len(solved), "f_error_px": float(np.median(np.abs(of("f_px"))))}
    result |= {"centre_error_px": float(np.median(of("centre_px"))), "centre_error_max_px": float(of("centre_px").max())}
    result |= {f"{key}": float(np.median(of(key))) for key in ("map_rms_px", "map_max_px", "seconds")}
    result |= {f"pull_rms_{key}": float(np.sqrt(np.mean(of(key) ** 2))) for key in ("f", "x0", "y0") if len(of(key))}
    return result


def boresight_rows(declared: Camera, frames: list, arguments) -> dict:
    """What boresight makes of a set, by itself and told which parameters the truth has."""
    with tempfile.TemporaryDirectory(prefix="boresight-peers-") as folder:
        peers.write_recording(Path(folder), declared, frames)
        given = ["--trust-identifications", "--physics", "none", *arguments.options.split()]
        rows = {"boresight": peers.boresight(arguments.boresight, Path(folder), *given)}
        if not arguments.quick:
            rows["boresight --solve auto"] = peers.boresight(arguments.boresight, Path(folder), *given, "--solve", "auto")
            few = ["--solve", ",".join(NAMES[:4])]
            rows["boresight --solve x0,y0,f,k1"] = peers.boresight(arguments.boresight, Path(folder), *given, *few)
        return rows


def compare(case: Case, catalog, arguments) -> tuple[dict, float]:
    """All programs on all sets of a case; also the mean number of stars of a set."""
    truth, declared = case.camera(), case.declared()
    allowed = lone(catalog, LONE_PX / truth.focal_length_px) & (catalog.magnitude < case.magnitude_limit)
    database = None
    if peers.tetra3rs is not None:
        database = peers.tetra3rs_database(catalog, catalog.direction, case.magnitude_limit, case.width_deg)
    found: dict = {}
    stars = []
    for number in range(arguments.sets):
        if number % 20 == 0:
            print(f"{case.name}: set {number} of {arguments.sets}", file=sys.stderr)
        random = np.random.default_rng([arguments.seed, CASES.index(case), number])
        frames = make_frames(case, catalog, allowed, random)
        stars.append(sum(len(frame.hip) for frame in frames))
        add = lambda name, one: found.setdefault(name, []).append(None if one is None else errors(one, truth))
        if arguments.keep:
            peers.write_recording(Path(arguments.keep) / f"{CASES.index(case)}-{number:04}", declared, frames)
        if not arguments.without_boresight:
            for name, one in boresight_rows(declared, frames, arguments).items():
                add(name, one)
        attitudes = starting_attitudes(frames, declared)
        for name, free in ORACLES.items():
            begin = time.perf_counter()
            fit = joint_fit(frames, declared, attitudes, free)
            add(name, peers.joint(fit, stars[-1], time.perf_counter() - begin))
        if database is not None:
            for name, (model, order) in TETRA3RS.items():
                add(name, peers.tetra3rs_calibration(database, declared, frames, model, order))
    return {name: summary(sets) for name, sets in found.items()}, float(np.mean(stars))


def text(case: Case, rows: dict, stars: float, sets: int) -> str:
    columns = ["program", "f px", "centre px", "(worst)", "map rms px", "map max px", "pull f", "x0", "y0", "seconds", "solved"]
    keys = ["f_error_px", "centre_error_px", "centre_error_max_px", "map_rms_px", "map_max_px"]
    keys += ["pull_rms_f", "pull_rms_x0", "pull_rms_y0", "seconds"]
    digits = [3, 2, 1, 4, 4, 2, 2, 2, 3]
    cell = lambda row, key, digit: f"{row[key]:.{digit}f}" if key in row else "-"
    cells = [[name, *(cell(row, k, d) for k, d in zip(keys, digits)), f"{row['solved']}"] for name, row in rows.items()]
    title = f"{case.name}; {stars:.0f} stars a set, {sets} sets; medians, pulls (error / stated σ) as rms"
    return peers.table(title, columns, cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boresight", default="target/release/boresight", help="the program")
    parser.add_argument("--options", default="", help="further options of `boresight calibrate`, in one string")
    parser.add_argument("--sets", type=int, default=200, help="sets of each case")
    parser.add_argument("--case", type=int, choices=range(len(CASES)), help="only this one")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="leave out the second row of boresight, told the true model")
    parser.add_argument("--without-boresight", action="store_true", help="only the others, which take a tenth of a second a set")
    parser.add_argument("--keep", help="also write the star lists into this folder")
    parser.add_argument("--output", help="write table and JSON into this folder")
    arguments = parser.parse_args()
    catalog = read_catalog()
    result = {
        "versions": peers.versions(None if arguments.without_boresight else arguments.boresight),
        "seed": arguments.seed,
        "options": arguments.options,
        "cases": {},
    }
    texts = [", ".join(f"{name} {version}" for name, version in result["versions"].items()), ""]
    if peers.tetra3rs is None:
        texts.append(f"tetra3rs is left out: {peers.TETRA3RS_MISSING}\n")
    for case in CASES if arguments.case is None else [CASES[arguments.case]]:
        rows, stars = compare(case, catalog, arguments)
        result["cases"][case.name] = {"stars": stars, "programs": rows}
        texts.append(text(case, rows, stars, arguments.sets))
    peers.deliver("synthetic", result, "\n".join(texts), arguments.output)


if __name__ == "__main__":
    main()
