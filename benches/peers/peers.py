"""The programs beside each other: how `boresight` and `tetra3rs` are given star lists, and how their cameras are read back."""

import json
import platform
import struct
import subprocess
import tempfile
import time
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path

import numpy as np

from camera import NAMES, Camera, unit
from sky import ROOT, Catalog

try:
    import tetra3rs
except ImportError as reason:  # the other peers are compared all the same, and the table says so
    tetra3rs = None
    TETRA3RS_MISSING = str(reason)


@dataclass(frozen=True)
class Found:
    """A calibrated camera of any program: its pixel → direction map and what it says of itself."""

    rays: object
    focal_length_px: float
    centre_px: tuple
    sigma: dict = field(default_factory=dict)
    seconds: float = float("nan")
    stars: int = 0
    rms_px: float = float("nan")
    note: str = ""
    camera: object = None


def write_recording(folder: Path, camera: Camera, frames: list, time_utc: str | None = None, site: dict | None = None) -> None:
    """A star list as a recording: what is declared of the camera is its size, its focal length, nothing else. `site` is the table
    of that name of another recording."""
    lines = ['format = "star-recording/1"', 'stars = "stars.csv"', "", "[camera]"]
    lines += [f"width_px = {camera.width_px}", f"height_px = {camera.height_px}", f"focal_length_px = {camera.focal_length_px:.6f}"]
    if site:
        lines += ["", "[site]", *(f"{key} = {value}" for key, value in site.items())]
    for _ in frames:
        lines += ["", "[[frames]]"] + ([f'time_utc = "{time_utc}"'] if time_utc else [])
    rows = ["frame,x_px,y_px,sigma_x_px,sigma_y_px,magnitude,hip"]
    for index, frame in enumerate(frames):
        for hip, (x, y), sigma, magnitude in zip(frame.hip, frame.pixel, frame.sigma_px, frame.magnitude):
            rows.append(f"{index},{x:.9f},{y:.9f},{sigma:.6g},{sigma:.6g},{magnitude:.2f},{hip}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "recording.toml").write_text("\n".join(lines) + "\n")
    (folder / "stars.csv").write_text("\n".join(rows) + "\n")


def run_boresight(program: str, arguments: list) -> tuple[dict, float]:
    """The JSON object that the program prints, and the wall time of the process. 3 is an answer: "no"."""
    begin = time.perf_counter()
    done = subprocess.run([program, "--quiet", *map(str, arguments), "--json"], capture_output=True, text=True)
    seconds = time.perf_counter() - begin
    if done.returncode not in (0, 3):
        raise RuntimeError(f"{program} {' '.join(map(str, arguments))}: exit code {done.returncode}: {done.stderr.strip()}")
    return json.loads(done.stdout), seconds


def boresight_camera(result: dict) -> Camera:
    """The camera of a calibration in JSON."""
    camera = result["camera"]
    return Camera(
        camera["width_px"],
        camera["height_px"],
        *camera["principal_point_px"],
        camera["focal_length_px"],
        *(camera.get(name) or 0.0 for name in ("k1", "p1", "p2")),
    )


def boresight(program: str, folder: Path, *options) -> Found | None:
    """Calibrates a recording. None if the answer is no."""
    result, seconds = run_boresight(program, ["calibrate", folder, *options])
    if result.get("camera") is None or result["status"] != "converged":
        return None
    camera = boresight_camera(result)
    return Found(
        camera.rays,
        camera.focal_length_px,
        (camera.x0_px, camera.y0_px),
        {parameter["name"]: parameter["sigma"] for parameter in result["parameters"]},
        result.get("seconds", seconds),
        result["stars"],
        result["rms_px"],
        "solver" if "seconds" in result else "process",
        camera,
    )


def boresight_of(program: str, camera: Camera, frames: list, *options, **circumstances) -> Found | None:
    """Calibrates star lists whose stars are named; the declared camera is `camera` with its principal point in the middle."""
    with tempfile.TemporaryDirectory(prefix="boresight-peers-") as folder:
        write_recording(Path(folder), camera, frames, **circumstances)
        return boresight(program, Path(folder), "--trust-identifications", *options)


def joint(fit, stars: int, seconds: float) -> Found:
    """The joint least squares as one of the programs."""
    camera = fit.camera
    sigma = dict(zip(NAMES, fit.sigma))  # the free ones are always the first
    rms = float(np.sqrt((fit.residuals_px**2).sum(axis=1).mean()))
    return Found(camera.rays, camera.focal_length_px, (camera.x0_px, camera.y0_px), sigma, seconds, stars, rms, camera=camera)


def tetra3rs_database(catalog: Catalog, directions: np.ndarray, magnitude_limit: float, width_deg: float):
    """A pattern database of the same stars in the same places: its catalogue is a table of ours, in its own packed form (magic,
    version, number of stars; per star number, right ascension and declination in degrees, magnitude, no motion)."""
    rows = np.flatnonzero(catalog.magnitude < magnitude_limit)
    ra, dec = np.degrees(np.arctan2(directions[:, 1], directions[:, 0])) % 360.0, np.degrees(np.arcsin(directions[:, 2]))
    packed = struct.pack("<4sIQ", b"GDR3", 1, len(rows))
    packed += b"".join(struct.pack("<qddfff", catalog.hip[k], ra[k], dec[k], catalog.magnitude[k], 0.0, 0.0) for k in rows)
    with tempfile.TemporaryDirectory(prefix="boresight-peers-") as folder:
        path = Path(folder) / "stars.bin"
        path.write_bytes(packed)
        return tetra3rs.SolverDatabase.generate_from_gaia(
            str(path),
            max_fov_deg=1.2 * width_deg,
            min_fov_deg=0.8 * width_deg,
            star_max_magnitude=magnitude_limit,
            verification_stars_per_fov=1000,
            epoch_proper_motion_year=None,
        )


def tetra3rs_calibration(database, camera: Camera, frames: list, model: str, order: int = 4, rounds: int = 2) -> Found | None:
    """Solves the frames (no prior attitude, only the declared width of the field), calibrates, solves again with that camera and
    calibrates again, as its own documentation does. Pixels count from the middle of the frame there. None if no frame is solved."""
    begin = time.perf_counter()
    stars = [np.column_stack([frame.pixel - camera.middle_px, 10.0 ** (-0.4 * frame.magnitude)]) for frame in frames]
    width_deg = np.degrees(2.0 * np.arctan(camera.width_px / 2.0 / camera.focal_length_px))
    shape, known, result, solved = (camera.height_px, camera.width_px), None, None, 0
    for _ in range(rounds):
        solves = [
            database.solve_from_centroids(
                one, fov_estimate_deg=width_deg, fov_max_error_deg=0.1 * width_deg, image_shape=shape, camera_model=known
            )
            for one in stars
        ]
        solved = sum(bool(solve) for solve in solves)
        if solved == 0:
            return None
        result = database.calibrate_camera(solves, stars, image_shape=shape, model=model, order=order)
        known = result.camera_model
    seconds = time.perf_counter() - begin

    def rays(pixel: np.ndarray) -> np.ndarray:
        plane = np.array([known.pixel_to_tanplane(x, y) for x, y in pixel - camera.middle_px])
        return unit(np.column_stack([plane, np.ones(len(plane))]))

    # A radial model has a centre of distortion of its own beside the offset of the origin.
    offset = np.array(known.crpix) + np.array(getattr(known.distortion, "center", (0.0, 0.0)))
    centre = tuple(camera.middle_px + offset)
    note = f"{solved} of {len(frames)} frames solved, {result.n_outliers} left out"
    return Found(rays, known.focal_length_px, centre, {}, seconds, result.n_inliers, result.rmse_after_px, note)


def versions(program: str | None) -> dict:
    """What was compared, on what."""
    found = {"python": platform.python_version(), "processor": platform.processor() or platform.machine()}
    for name in ("numpy", "scipy", "tetra3rs", "opencv-python-headless"):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "not installed"
    if program:
        found["boresight"] = subprocess.run([program, "--version"], capture_output=True, text=True, check=True).stdout.strip()
        commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True)
        found["commit"] = commit.stdout.strip() or "unknown"
    return found


def table(title: str, columns: list, rows: list) -> str:
    """A table for people; the first column is text, the others as they are given."""
    cells = [columns] + [[str(cell) for cell in row] for row in rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(columns))]
    lines = ["  ".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths))) for row in cells]
    return "\n".join([title, lines[0], "-" * len(lines[0]), *lines[1:], ""])


def deliver(name: str, object_: dict, text: str, output: str | None) -> None:
    """Prints the table, and writes it and the JSON object beside it where asked for."""
    print(text)
    if output:
        folder = Path(output)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.json").write_text(json.dumps(object_, indent=1) + "\n")
        (folder / f"{name}.txt").write_text(text + "\n")
        print(f"written: {folder / name}.json and .txt")
