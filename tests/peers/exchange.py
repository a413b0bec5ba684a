#!/usr/bin/env python3
"""What other programs make of the cameras that `boresight export` writes.

    python3 tests/peers/exchange.py BORESIGHT CALIBRATION.json

BORESIGHT is the built program, CALIBRATION.json any result of `boresight calibrate -o`: its camera is replaced by those below, its attitudes are
kept. Every format is read by its own program (OpenCV's FileStorage and projectPoints, astropy.wcs, tetra3rs, mrcal; those that are not
installed are skipped by name), and its points are held against `boresight map`. Prints one line a case, and with --freeze the values that
tests/it/exchange.rs holds.
"""
import json, os, subprocess, sys, tempfile
import numpy as np

CAMERAS = {
    "narrow": dict(width_px=1024, height_px=768, principal_point_px=[510.0, 408.0], focal_length_px=5114.0, k1=3.8e-9, p1=0.0, p2=0.0),
    "wide": dict(width_px=2048, height_px=1536, principal_point_px=[1023.5, 767.5], focal_length_px=4619.0, k1=-0.15 / 4619.0**2, p1=0.0, p2=0.0),
    "decentred": dict(width_px=1280, height_px=1024, principal_point_px=[655.25, 498.5], focal_length_px=2400.0, k1=1.5e-8, p1=4e-7, p2=-7e-7),
}
GRID = 33


def run(*args, code=0):
    done = subprocess.run(args, capture_output=True, text=True)
    assert done.returncode == code, (args, done.returncode, done.stderr)
    return done.stdout


def our_map(program, calibration):
    points = json.loads(run(program, "map", calibration, "--grid", str(GRID), "--json"))["points"]
    pixel = np.array([[p["x_px"], p["y_px"]] for p in points])
    return pixel, np.array([p["direction"] for p in points])


def said(name, format, there, pixel, stated):
    distance = np.hypot(*(there - pixel).T)
    print(f"{name:10} {format:9} rms {np.sqrt((distance**2).mean()):.3e} px  max {distance.max():.3e} px  stated max {stated:.3e} px")
    assert distance.max() <= stated + 1e-6, "more than was stated"


def opencv(path, direction):
    import cv2
    storage = cv2.FileStorage(path, cv2.FILE_STORAGE_READ)
    k, d = storage.getNode("camera_matrix").mat(), storage.getNode("distortion_coefficients").mat()
    return cv2.projectPoints(direction, np.zeros(3), np.zeros(3), k, d)[0][:, 0]


def ros(path, direction):
    import cv2, yaml
    info = yaml.safe_load(open(path))
    k = np.array(info["camera_matrix"]["data"]).reshape(3, 3)
    return cv2.projectPoints(direction, np.zeros(3), np.zeros(3), k, np.array(info["distortion_coefficients"]["data"]))[0][:, 0]


def mrcal_points(path, direction):
    import mrcal
    return mrcal.project(np.ascontiguousarray(direction), *mrcal.cameramodel(path).intrinsics())


def tetra3rs_points(path, direction):
    import tetra3rs
    camera = json.load(open(path))
    r = camera["distortion"]["Radial"]
    distortion = tetra3rs.RadialDistortion(r["k1"], r["k2"], r["k3"], r["p1"], r["p2"])
    size = [camera["image_width"], camera["image_height"]]
    model = tetra3rs.CameraModel(camera["focal_length_px"], *size, crpix=camera["crpix"], parity_flip=camera["parity_flip"], distortion=distortion)
    points = [model.tanplane_to_pixel(x / z, y / z) for x, y, z in direction]
    return np.array(points) + (np.array(size) - 1) / 2


def cedar_points(path, direction):
    """tetra3's own equations (tetra3.py, _undistort_centroids), inverted here in double precision; held against the package if it is there."""
    camera = json.load(open(path))
    from scipy.spatial.transform import Rotation
    x, y, z = Rotation.from_rotvec(camera["rotation_rad"]).apply(direction).T
    width, k = camera["image_width"], camera["distortion"]
    scale = width / 2 / np.tan(np.radians(camera["fov_estimate"]) / 2)
    ideal = scale * np.array([x / z, y / z])
    target, r = np.hypot(*ideal), np.hypot(*ideal)
    kp = k * (2 / width) ** 2
    for _ in range(50):
        r -= (r * (1 - kp * r**2) / (1 - k) - target) / ((1 - 3 * kp * r**2) / (1 - k))
    factor = np.divide(r, target, out=np.ones_like(r), where=target > 0)
    middle = np.array([width, camera["image_height"]]) / 2
    measured = (ideal * factor).T + middle  # tetra3 counts from the corner
    try:
        from tetra3.tetra3 import _undistort_centroids
        theirs = _undistort_centroids(measured[:, ::-1], middle[::-1] * 2, k)[:, ::-1]
        print(f"{'':10} cedar-solve's own function differs by {abs(theirs - middle - ideal.T).max():.1e} px (it computes in single precision)")
    except ImportError:
        pass
    return measured - 0.5


FORWARD = {"opencv": opencv, "ros": ros, "mrcal": mrcal_points, "tetra3rs": tetra3rs_points, "tetra3": cedar_points}


def rotation(quaternion):
    from scipy.spatial.transform import Rotation
    return Rotation.from_quat(quaternion).as_matrix()


def headers(program, name, calibration, folder, freeze):
    from astropy.io import fits
    from astropy.wcs import WCS
    attitudes = {f["frame"]: f["camera_from_icrs"] for f in json.load(open(calibration))["per_frame"] if f["camera_from_icrs"]}
    focal = json.load(open(calibration))["camera"]["focal_length_px"]
    pixel, direction = our_map(program, calibration)
    for format in ("sip", "tpv"):
        result = json.loads(run(program, "export", calibration, "--to", format, "-o", folder, "--json"))
        for file, (frame, attitude) in zip(result["files"], sorted(attitudes.items())):
            assert file.endswith(f"frame-{frame:04}.wcs")
            wcs = WCS(fits.getheader(file))
            ra, dec = np.radians(wcs.all_pix2world(pixel, 0)).T
            sky = np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])
            ours = rotation(attitude).T @ (direction.T)
            angle = np.arctan2(np.linalg.norm(np.cross(sky.T, ours.T), axis=1), (sky * ours).sum(axis=0)) * focal
            back = wcs.all_world2pix(np.degrees(np.array([ra, dec])).T, 0, tolerance=1e-9)
            print(f"{name:10} {format:4} {frame:4} max {angle.max():.3e} px, and back {np.hypot(*(back - pixel).T).max():.3e} px", end="")
            if format == "sip" and wcs.sip is not None and wcs.sip.ap is not None:
                plane = wcs.wcs_world2pix(np.degrees(np.array([ra, dec])).T, 0)
                print(f", by AP and BP {np.hypot(*(plane + ap(wcs, plane) - pixel).T).max():.3e} px", end="")
            print()
            assert angle.max() <= 0.01 or result["residual"]["max_px"] > 0.009
            if freeze and frame == min(attitudes):
                for index in (0, 16, GRID * GRID // 2, GRID * GRID - 1):
                    print(f"    ({pixel[index].tolist()}, [{float(np.degrees(ra[index]))!r}, {float(np.degrees(dec[index]))!r}]),")


def ap(wcs, plane):
    """SIP's AP and BP on a pixel without distortion (counted from 0)."""
    u, v = (plane - (wcs.wcs.crpix - 1)).T
    sum_of = lambda m: sum(m[i, j] * u**i * v**j for i in range(len(m)) for j in range(len(m)))
    return np.array([sum_of(wcs.sip.ap), sum_of(wcs.sip.bp)]).T


def main():
    freeze = "--freeze" in sys.argv
    program, template = [argument for argument in sys.argv[1:] if argument != "--freeze"]
    with tempfile.TemporaryDirectory() as folder:
        for name, camera in CAMERAS.items():
            calibration = json.load(open(template))
            calibration["camera"] = camera
            path = os.path.join(folder, f"{name}.json")
            json.dump(calibration, open(path, "w"))
            pixel, direction = our_map(program, path)
            for format, points in FORWARD.items():
                file = os.path.join(folder, f"{name}.{format}")
                try:
                    text = run(program, "export", path, "--to", format, "-o", file, "--json", "--force")
                    result = json.loads(text)
                    there = points(file, direction)
                except ImportError as error:
                    print(f"{name:10} {format:9} skipped: {error}")
                    continue
                said(name, format, there, pixel, result["residual"]["max_px"])
                if freeze:
                    print(f"    {open(file).read()}" if format == "opencv" else "", end="")
                    for index in (0, 16, GRID * GRID // 2, GRID * GRID - 1):
                        print(f"    ({direction[index].tolist()}, {there[index].tolist()}),")
            try:
                headers(program, name, path, os.path.join(folder, name), freeze)
            except ImportError as error:
                print(f"{name:10} sip, tpv  skipped: {error}")


main()
