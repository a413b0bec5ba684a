#!/usr/bin/env python3
"""Our files in other programs: python tests/interop/check.py BORESIGHT FOLDER, called by `run` beside this file.

Every check prints one line; a check that raises has failed. The last line is `N passed, N failed`.
"""
import json
import os
import shutil
import sys
import traceback

import warnings

import numpy as np

import exchange
from exchange import run

HERE = os.path.dirname(os.path.abspath(__file__))
ROOT = os.path.dirname(os.path.dirname(HERE))
# World coordinates lead a place of the catalogue to where the model has the star's image, px.
NEAR_PX = 0.01

counts = {"passed": 0, "failed": 0}


def check(name, function, *arguments):
    try:
        said = function(*arguments)
        counts["passed"] += 1
        print(f"ok      {name}: {said}", flush=True)
    except Exception as error:  # whatever goes wrong is a failure of this check alone
        counts["failed"] += 1
        print(f"FAILED  {name}: {error}", flush=True)
        traceback.print_exc()


def table(folder, name):
    from astropy.table import Table

    return Table.read(os.path.join(folder, f"{name}.csv"), format="ascii.csv")


def frames_of(folder):
    """The headers by frame: their files are called by its number and name."""
    return {int(name[:4]): os.path.join(folder, name) for name in sorted(os.listdir(folder)) if name.endswith(".wcs")}


def places_lead_to_the_model(folder):
    """astropy on the .wcs: right ascension and declination of matches.csv to the measured place less the residual."""
    from astropy.io import fits
    from astropy.wcs import WCS
    from astropy.wcs.utils import wcs_to_celestial_frame

    rows, headers = table(folder, "matches"), frames_of(folder)
    stars, most = 0, 0.0
    for frame in np.unique(rows["frame"]):
        own = rows[rows["frame"] == frame]
        wcs = WCS(fits.getheader(headers[int(frame)]))
        assert wcs_to_celestial_frame(wcs).name == "icrs"
        there = np.array(wcs.all_world2pix(own["ra_deg"], own["dec_deg"], 0, tolerance=1e-9, maxiter=100)).T
        model = np.column_stack([own["x_px"] - own["residual_x_px"], own["y_px"] - own["residual_y_px"]])
        off = np.hypot(*(there - model).T)
        stars, most = stars + len(own), max(most, off.max())
    assert stars > 20, f"{stars} stars tell nothing"
    assert most <= NEAR_PX, f"{most:.4f} px off"
    return f"{stars} stars in {len(headers)} frames, at most {most:.1e} px off, places of {rows['epoch_yr'][0]:.4f}"


def light_is_another_thing(program, recording, folder):
    """With --wcs apparent the same places miss by aberration and refraction: the check above can fail."""
    run(program, "identify", recording, "-o", folder, "--wcs", "apparent")
    try:
        said = places_lead_to_the_model(folder)
    except AssertionError as error:
        return str(error)
    raise AssertionError(f"apparent directions are taken for places: {said}")


def tables_are_read(folder, name):
    """astropy's own reader of Parquet, without a warning, and the same as the CSV."""
    from astropy.table import Table

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parquet = Table.read(os.path.join(folder, f"{name}.parquet"))
    csv = table(folder, name)
    assert parquet.colnames == csv.colnames and len(parquet) == len(csv) > 0
    for column in csv.colnames:
        ours, theirs = csv[column], parquet[column]
        if theirs.dtype.kind == "b":
            assert [str(cell).lower() == "true" for cell in ours] == list(theirs), column
        elif ours.dtype.kind in "US" or theirs.dtype.kind in "US":
            assert "None" not in theirs, f"{column}: a missing word has become the word None"
            filled = [str(cell) if cell is not np.ma.masked else "" for cell in ours]
            assert filled == [str(cell) for cell in theirs], column
        else:
            filled = np.array(np.ma.filled(np.ma.asarray(ours, dtype=float), np.nan))
            assert np.array_equal(filled, np.asarray(theirs, dtype=float), equal_nan=True), column
    return f"{len(parquet)} rows, {len(parquet.colnames)} columns"


def regions_are_read(folder):
    """DS9's regions through astropy's `regions`: one for each detection, at its place."""
    from regions import Regions

    detections, count = table(folder, "detections"), 0
    for name in sorted(name for name in os.listdir(folder) if name.endswith(".reg")):
        own = detections[detections["frame"] == int(name[:4])]
        centres = [region.center for region in Regions.read(os.path.join(folder, name), format="ds9")]
        found = np.array(sorted((centre.x, centre.y) for centre in centres))
        expected = np.array(sorted(zip(own["x_px"], own["y_px"])))
        assert found.shape == expected.shape, f"{name}: {len(found)} of {len(expected)}"
        assert np.abs(found - expected).max() < 1e-4
        count += len(found)
    assert count > 20
    return f"{count} regions"


def images_are_read(folder):
    """The FITS image with world coordinates: the header alone says the same."""
    from astropy.io import fits
    from astropy.wcs import WCS

    headers = frames_of(folder)
    for path in headers.values():
        with fits.open(path[:-3] + "fits") as image:
            image.verify("exception")
            assert image[0].data.ndim == 2 and image[0].data.std() > 0
            grid = np.array([[0.0, 0.0], [image[0].data.shape[1] - 1.0, 10.0]])
            apart = WCS(image[0].header).all_pix2world(grid, 0) - WCS(fits.getheader(path)).all_pix2world(grid, 0)
            assert np.abs(apart).max() < 1e-12
    return f"{len(headers)} images"


def exported_places(program, calibration, identified, folder):
    """`export --to sip|tpv` of a calibration: its own control points through astropy, as above."""
    from astropy.io import fits
    from astropy.wcs import WCS

    rows = table(identified, "matches")
    place = {(int(row["frame"]), int(row["hip"])): (row["ra_deg"], row["dec_deg"]) for row in rows}
    points = [point for point in json.load(open(calibration))["points"] if point["residual_px"] and (point["frame"], point["hip"]) in place]
    said = []
    for format in ("sip", "tpv"):
        into = os.path.join(folder, format)
        result = json.loads(run(program, "export", calibration, "--to", format, "-o", into, "--json"))
        headers = {int(file[-8:-4]): WCS(fits.getheader(file)) for file in result["files"]}
        off = []
        for point in points:
            x, y = headers[point["frame"]].all_world2pix([place[point["frame"], point["hip"]]], 0, tolerance=1e-9, maxiter=100)[0]
            dx, dy = point["residual_px"]
            off.append(np.hypot(point["x_px"] - dx - x, point["y_px"] - dy - y))
        assert len(off) > 20 and max(off) <= NEAR_PX, f"{format}: {max(off):.4f} px over {len(off)} stars"
        said.append(f"{format} {max(off):.1e} px")
    return f"{len(points)} stars, " + ", ".join(said)


def walkthroughs(program, folder):
    """The walk-throughs of CONTRIBUTING.md, in a copy of the checkout."""
    import subprocess

    done = subprocess.run([os.path.join(HERE, "walkthrough"), program, folder], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def main(program, folder):
    from astropy.wcs import FITSFixedWarning

    # A header without an image, and MJD-OBS made of DATE-OBS: both are meant.
    warnings.simplefilter("ignore", FITSFixedWarning)
    shutil.rmtree(folder, ignore_errors=True)
    os.makedirs(folder)
    at = lambda *names: os.path.join(folder, *names)
    with open(at("machine.toml"), "w") as out:
        out.write(run(program, "preset", "show", "machine-vision-35mm"))
    scenes = {"demo": os.path.join(ROOT, "src/scene/demo.toml"), "machine-vision-35mm": at("machine.toml"), "30 degrees": os.path.join(HERE, "thirty.toml")}
    for name, scene in scenes.items():
        recording, identified = at(name), at(name + " identified")
        run(program, "simulate", scene, "-o", recording, "--backend", "cpu")
        run(program, "identify", recording, "-o", identified, "--fits")
        check(f"{name}: places through astropy", places_lead_to_the_model, identified)
        check(f"{name}: matches.parquet", tables_are_read, identified, "matches")
        check(f"{name}: detections.parquet", tables_are_read, identified, "detections")
        check(f"{name}: regions", regions_are_read, identified)
        check(f"{name}: FITS images", images_are_read, identified)
    machine = "machine-vision-35mm"
    check(f"{machine}: --wcs apparent", light_is_another_thing, program, at(machine), at(machine + " apparent"))
    run(program, "calibrate", at(machine), "-o", at("calibrated"))
    template = at("calibrated", "calibrate.json")
    check(f"{machine}: exported places", exported_places, program, template, at(machine + " identified"), at("places"))
    for name in exchange.CAMERAS:
        for format in exchange.FORWARD:
            check(f"camera {name} in {format}", exchange.of_exports, program, template, folder, name, format)
        path = exchange.placed(template, name, folder)
        check(f"camera {name} in sip and tpv", exchange.of_headers, program, path, at(name + " headers"))
    check("walk-throughs of CONTRIBUTING.md", walkthroughs, program, at("walkthrough"))
    print(f"{counts['passed']} passed, {counts['failed']} failed")
    return 1 if counts["failed"] or not counts["passed"] else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
