#!/usr/bin/env python3
"""A real recording: the calibrator beside tetra3rs and the joint least squares, on the same star images.

Stars are found, measured and identified by `boresight`; all programs are given those star images and the same directions
(proper motion applied, nothing else; two rows more show what all physics that follows from the recording does). Every camera is
judged alike: the attitude of each frame is fitted to the camera's own rays, in sample and with the frame left out of the
calibration, over the same stars, none left away.
"""

import argparse
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

import peers
from camera import NAMES, Camera, Frame, angles_px, joint_fit, starting_attitudes
from sky import read_catalog

ARCSEC_RAD = np.pi / 180.0 / 3600.0
# Of a circular Gaussian: rms of the radius over its median.
RMS_OVER_MEDIAN = 1.0 / np.sqrt(np.log(2.0))
TETRA3RS = {"tetra3rs radial": ("radial", 4)} | {f"tetra3rs polynomial {order}": ("polynomial", order) for order in (3, 4, 5)}


def frames_of(points: list, wanted) -> list:
    """Star images by frame, those that are wanted."""
    points = [point for point in points if wanted(point)]
    frames = []
    for index in sorted({point["frame"] for point in points}):
        here = [point for point in points if point["frame"] == index]
        column = lambda name: np.array([point[name] for point in here])
        covariance = column("covariance_px2")
        sigma = np.sqrt((covariance[:, 0] + covariance[:, 2]) / 2.0)
        pixel = np.column_stack([column("x_px"), column("y_px")])
        frames.append(Frame(column("hip"), column("direction"), pixel, sigma, column("magnitude")))
    return frames


def joint(frames: list, declared: Camera, free: tuple) -> peers.Found:
    """The joint least squares, all stars alike; standard errors from its own residuals."""
    alike = [Frame(f.hip, f.direction, f.pixel, np.full(len(f.hip), 0.1), f.magnitude) for f in frames]
    fit = joint_fit(alike, declared, starting_attitudes(alike, declared), free)
    found = peers.joint(fit, sum(len(frame.hip) for frame in frames), float("nan"))
    return replace(found, sigma={name: sigma * np.sqrt(fit.chi2_per_dof) for name, sigma in found.sigma.items()})


def judge(calibrate, frames: list, scale_px: float) -> dict | None:
    """In-sample and held-out residuals of a program: rms, and the rms that the median tells."""
    whole = calibrate(frames)
    if whole is None:
        return None
    sample = np.concatenate([angles_px(whole.rays, frame, scale_px) for frame in frames])
    held = []
    for index, frame in enumerate(frames):
        found = calibrate(frames[:index] + frames[index + 1 :])
        if found is None:
            return None
        held.append(angles_px(found.rays, frame, scale_px))
    held = np.concatenate(held)
    rms = lambda values: float(np.sqrt(np.mean(values**2)))
    row = {"in_sample_rms_px": rms(sample), "in_sample_median_px": float(np.median(sample) * RMS_OVER_MEDIAN)}
    row |= {"held_out_rms_px": rms(held), "held_out_median_px": float(np.median(held) * RMS_OVER_MEDIAN)}
    row |= {"held_out_rms_arcsec": row["held_out_rms_px"] / scale_px / ARCSEC_RAD, "star_images": len(sample)}
    row |= {"f_px": whole.focal_length_px, "x0_px": float(whole.centre_px[0]), "y0_px": float(whole.centre_px[1])}
    row |= {f"sigma_{name}_px": float(whole.sigma[name]) for name in ("f", "x0", "y0") if name in whole.sigma}
    return row | {"used": whole.stars, "own_rms_px": whole.rms_px, "note": whole.note}


def table(title: str, rows: dict) -> str:
    columns = ["program", "in-sample px", "(median)", "held-out px", "(median)", "held-out ″", "f px", "x0 px", "y0 px", "stars used"]

    def with_sigma(row, value, name, digits):
        sigma = row.get(f"sigma_{name}_px")
        return f"{row[value]:.{digits}f}" + (f" ± {sigma:.{digits}f}" if sigma is not None else " ± none")

    cells = []
    for name, row in rows.items():
        if row is None:
            cells.append([name, "no answer"] + [""] * 8)
            continue
        keys = ["in_sample_rms_px", "in_sample_median_px", "held_out_rms_px", "held_out_median_px"]
        cells.append(
            [name, *(f"{row[key]:.4f}" for key in keys), f"{row['held_out_rms_arcsec']:.3f}", with_sigma(row, "f_px", "f", 2)]
            + [with_sigma(row, "x0_px", "x0", 1), with_sigma(row, "y0_px", "y0", 1), f"{row['used']} of {row['star_images']}"]
        )
    return peers.table(title, columns, cells)


def programs(arguments, declared: Camera, catalog, frames: list, directions: np.ndarray, time_utc: str) -> dict:
    """What calibrates frames, by name; `directions` are those of the catalogue's stars at the time of the frames."""

    def boresight(*more):
        options = ["--physics", "proper-motion", *arguments.options.split(), "--all-stars", *more]
        return lambda some: peers.boresight_of(arguments.boresight, declared, some, *options, time_utc=time_utc)

    def tetra3rs(model, order):
        return lambda some: peers.tetra3rs_calibration(database, declared, some, model, order)

    found = {"boresight": boresight(), "boresight --solve x0,y0,f,k1": boresight("--solve", "x0,y0,f,k1")}
    found["joint least squares x0,y0,f,k1"] = lambda some: joint(some, declared, NAMES[:4])
    found["joint least squares x0,y0,f,k1,p1,p2"] = lambda some: joint(some, declared, NAMES)
    if peers.tetra3rs is not None:
        faintest = max(frame.magnitude.max() for frame in frames) + 0.01
        width_deg = np.degrees(2.0 * np.arctan(declared.width_px / 2.0 / declared.focal_length_px))
        database = peers.tetra3rs_database(catalog, directions, faintest, width_deg)
        found |= {name: tetra3rs(model, order) for name, (model, order) in TETRA3RS.items()}
    return found


def check_directions(points: list, catalog, directions: np.ndarray, scale_px: float) -> None:
    """The program's own directions with proper motion and those that tetra3rs is given have to be the same."""
    rows = catalog.index()
    apart = [np.linalg.norm(np.array(point["direction"]) - directions[rows[point["hip"]]]) for point in points]
    if max(apart) * scale_px > 1e-3:
        raise SystemExit(f"the directions of the two catalogues are {max(apart) * scale_px:.4f} px apart; they must be the same")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", help="folder with recording.toml, all frames of about one time")
    parser.add_argument("--boresight", default="target/release/boresight", help="the program")
    parser.add_argument("--options", default="", help="further options of `boresight calibrate`, in one string")
    parser.add_argument("--output", help="write table and JSON into this folder")
    arguments = parser.parse_args()
    manifest = tomllib.loads((Path(arguments.recording) / "recording.toml").read_text())
    circumstances = {"time_utc": manifest["frames"][0]["time_utc"], "site": manifest.get("site")}
    more = arguments.options.split()
    moved, _ = peers.run_boresight(arguments.boresight, ["calibrate", arguments.recording, "--physics", "proper-motion", *more])
    known, _ = peers.run_boresight(arguments.boresight, ["calibrate", arguments.recording, "--physics", "known", *more])
    points, nominal = moved["control_points"]["points"], moved["control_points"]["nominal"]
    declared = Camera(nominal["width_px"], nominal["height_px"], *nominal["principal_point_px"], nominal["focal_length_px"])
    scale_px = moved["camera"]["focal_length_px"]
    catalog = read_catalog()
    directions = catalog.at(moved["control_points"]["frames"][0]["observation"]["epoch_yr"])
    check_directions(points, catalog, directions, scale_px)
    # The same star images with the directions that all known physics gives.
    bent = {(point["frame"], point["hip"]): point["direction"] for point in known["control_points"]["points"]}
    bent = [point | {"direction": bent[key]} for point in points if (key := (point["frame"], point["hip"])) in bent]

    versions = peers.versions(arguments.boresight)
    whole = {key: moved[key] for key in ("parameters", "rms_px", "held_out_rms_px", "stars", "stars_offered", "frames")}
    output = {"versions": versions, "recording": Path(arguments.recording).name, "options": arguments.options}
    output |= {"boresight_on_the_images": whole, "all_known_physics": known["physics"], "selections": {}}
    held_out = whole["held_out_rms_px"] or float("nan")
    images = f"boresight from the images: {whole['stars']} of {whole['stars_offered']} star images"
    texts = [", ".join(f"{name} {version}" for name, version in versions.items()), ""]
    texts += [f"{images}, in-sample {whole['rms_px']:.4f} px, held-out {held_out:.4f} px (its own figures)"]
    texts += [f"all known physics: {', '.join(known['physics'])}", ""]
    if peers.tetra3rs is None:
        texts.append(f"tetra3rs is left out: {peers.TETRA3RS_MISSING}\n")

    def with_physics(some):
        options = ["--physics", "known", *more, "--all-stars"]
        return peers.boresight_of(arguments.boresight, declared, some, *options, **circumstances)

    def bright(point):
        return point["magnitude"] < 7.0 and point["has_proper_motion"]

    for title, wanted in {"V < 7, proper motion known": bright, "all identified stars": lambda _: True}.items():
        frames, bent_frames = frames_of(points, wanted), frames_of(bent, wanted)
        those = programs(arguments, declared, catalog, frames, directions, circumstances["time_utc"])
        rows = {name: judge(calibrate, frames, scale_px) for name, calibrate in those.items()}
        rows["boresight, all known physics"] = judge(with_physics, bent_frames, scale_px)
        rows["joint x0,y0,f,k1, all known physics"] = judge(lambda some: joint(some, declared, NAMES[:4]), bent_frames, scale_px)
        count = sum(len(frame.hip) for frame in frames)
        output["selections"][title] = {"star_images": count, "programs": rows}
        texts.append(table(f"{title}: {count} star images in {len(frames)} frames", rows))
    peers.deliver("esa2019", output, "\n".join(texts), arguments.output)


if __name__ == "__main__":
    main()
