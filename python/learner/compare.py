"""Finds the stars of real frames by the network and by `boresight detect`: compare.py BORESIGHT NETWORK.pt FOLDER RECORDING….

Truth are the stars of the catalogue, down to V = 8, where camera and attitude put them that `boresight identify` finds for each frame: `boresight simulate`
says where. Stars that one way or the other is to find lie at least 10 px from the edge and from every other star of the catalogue.
"""

import csv
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import torch
from network import StarNetwork
from PIL import Image

NEAR_PX = 2.0
APART_PX = 10.0
BANDS = ((-2.0, 5.0), (5.0, 6.0), (6.0, 7.0), (7.0, 8.0))


def ran(program: str, *words: str) -> dict:
    """The result of a command."""
    done = subprocess.run([program, *words, "--json", "--quiet"], capture_output=True, text=True)
    if done.returncode not in (0, 3):
        raise SystemExit(f"boresight {' '.join(words)} ended with {done.returncode}: {done.stderr}")
    return json.loads(done.stdout)


def catalogue_stars(program: str, frame: dict, folder: Path) -> np.ndarray:
    """Stars of the catalogue on a frame that is identified: x, y (px) and magnitude."""
    camera = frame["camera"]
    keys = [f"{name} = {camera[name]}" for name in ("width_px", "height_px", "focal_length_px", "k1", "p1", "p2", "principal_point_px")]
    ra, dec = frame["centre_radec_deg"]
    scene = folder / "scene.toml"
    scene.write_text(
        f'format = "boresight-scene/1"\nsky = {{ physics = "none", faintest_magnitude = 8.0 }}\n[camera]\n'
        + "\n".join(keys)
        + f"\n[[frames]]\nexposure_s = 1.0\nboresight_radec_deg = [{ra}, {dec}]\nroll_deg = {frame['roll_deg']}\n"
    )
    ran(program, "simulate", str(scene), "-o", str(folder / "twin"), "--backend", "cpu", "--no-pixel-shifts", "--force")
    with open(folder / "twin/truth/stars.csv") as rows:
        return np.array([[float(row[name]) for name in ("x_px", "y_px", "magnitude")] for row in csv.DictReader(rows)])


def counted(found: np.ndarray, stars: np.ndarray, size: tuple[int, int]) -> list[int]:
    """Of each band of brightness stars and those found, and then points that no star of the catalogue is near."""
    height, width = size
    apart = np.linalg.norm(found[:, None] - stars[None, :, :2], axis=2) if len(found) else np.full((1, len(stars)), np.inf)
    between = np.linalg.norm(stars[:, None, :2] - stars[None, :, :2], axis=2)
    np.fill_diagonal(between, np.inf)
    x, y, magnitude = stars.T
    lone = (between.min(axis=1) > APART_PX) & (np.minimum(x, width - 1 - x) > APART_PX) & (np.minimum(y, height - 1 - y) > APART_PX)
    numbers = []
    for low, high in BANDS:
        of = lone & (magnitude >= low) & (magnitude < high)
        numbers += [int(of.sum()), int((apart.min(axis=0)[of] <= NEAR_PX).sum())]
    return [*numbers, int((apart.min(axis=1) > NEAR_PX).sum()) if len(found) else 0]


def main(program: str, network_file: str, folder: str, *recordings: str) -> None:
    """Prints a row for each recording and way."""
    saved = torch.load(network_file)
    network = StarNetwork()
    network.load_state_dict(saved["network"])
    work = Path(folder)
    work.mkdir(parents=True, exist_ok=True)
    bands = " | ".join(f"V {low:g} to {high:g}" if low > 0 else f"V < {high:g}" for low, high in BANDS)
    print(f"| recording, frames | way | {bands} | points beside, a frame |\n|---|---|{'---|' * len(BANDS)}---|")
    for recording in recordings:
        identified = ran(program, "identify", recording, "--wcs", "apparent")
        detected = ran(program, "detect", recording)
        frames = [frame for frame in identified["frames"] if frame["status"] == "identified"]
        sums = {"boresight detect": np.zeros(9, int), "network": np.zeros(9, int)}
        apart = []
        for frame in frames:
            path = Path(recording, frame["file"]) if Path(recording).is_dir() else Path(recording)
            with Image.open(path) as opened:
                image = np.asarray(opened.convert("L") if opened.mode in ("RGB", "P") else opened)
            own = next(one for one in detected["frames"] if one["file"] == frame["file"])
            ours = np.array([[star["x_px"], star["y_px"]] for star in own["stars"]]).reshape(-1, 2)
            stars = catalogue_stars(program, frame, work)
            sums["boresight detect"] += counted(ours, stars, image.shape)
            sums["network"] += counted(network.stars(image, saved["threshold"])[:, :2], stars, image.shape)
            apart += [np.linalg.norm(ours - star[:2], axis=1).min() for star in stars[stars[:, 2] < 5.0]]
        # Truth that is not where the stars are would make everything wrong.
        if frames and np.median(apart) > 0.7:
            raise SystemExit(f"{recording}: bright stars are {np.median(apart):.2f} px from where camera and attitude put them")
        for way, sum in sums.items():
            shares = " | ".join(f"{sum[2 * band + 1]} of {sum[2 * band]}" for band in range(len(BANDS)))
            print(f"| {Path(recording).stem}, {len(frames)} | {way} | {shares} | {sum[-1] / max(len(frames), 1):.1f} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
