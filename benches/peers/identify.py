"""tetra3rs on the star lists of `benches/identify.rs`: reads lists.csv, stars.csv and catalog.csv in the folder that it is given, writes answers.csv.

Its pattern database is made of the catalogue's own stars, so the two have the same sky; x and y count from the middle of the frame there.
"""

import csv
import sys
import time
from itertools import groupby
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from peers import tetra3rs, tetra3rs_database

SIDE_PX = 1024
WIDTH_DEG = 15.0
FAINTEST = 6.0


def database(folder: Path):
    """Patterns for fields around the width of all rows, as far as `peers.tetra3rs_database` reaches."""
    table = np.loadtxt(folder / "catalog.csv", delimiter=",", skiprows=1)
    ra, dec = np.radians(table[:, 1]), np.radians(table[:, 2])
    directions = np.column_stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    catalog = SimpleNamespace(hip=table[:, 0].astype(int) + 1, magnitude=table[:, 3])
    return tetra3rs_database(catalog, directions, FAINTEST, WIDTH_DEG)


def main() -> None:
    folder = Path(sys.argv[1])
    if tetra3rs is None:
        (folder / "answers.csv").write_text("row,trial,ms,solved,ra_deg,dec_deg\n")
        print("tetra3rs is not installed: its columns are left out", file=sys.stderr)
        return
    solver = database(folder)
    with (folder / "stars.csv").open(newline="") as text:
        stars = {key: list(group) for key, group in groupby(csv.reader(text), key=lambda record: tuple(record[:2]))}
    with (folder / "lists.csv").open(newline="") as lists, (folder / "answers.csv").open("w", newline="") as answers:
        writer = csv.writer(answers)
        writer.writerow(["row", "trial", "ms", "solved", "ra_deg", "dec_deg"])
        reader = csv.reader(lists)
        next(reader)
        for row, trial, width, tolerance in reader:
            # A list may be empty: it is refused like any other that shows too little.
            places = np.array([record[2:5] for record in stars.get((row, trial), [])], dtype=float).reshape(-1, 3)
            middle = (SIDE_PX - 1) / 2.0
            centroids = np.column_stack([places[:, :2] - middle, 10.0 ** (-0.4 * places[:, 2])])
            begin = time.thread_time()
            found = solver.solve_from_centroids(
                centroids, fov_estimate_deg=float(width), fov_max_error_deg=float(tolerance), image_shape=(SIDE_PX, SIDE_PX)
            )
            ms = 1e3 * (time.thread_time() - begin)
            middle_sky = (found.ra_deg, found.dec_deg) if found else ("nan", "nan")
            writer.writerow([row, trial, f"{ms:.4f}", int(bool(found)), *middle_sky])


if __name__ == "__main__":
    main()
