#!/usr/bin/env python3
"""What other programs make of the cameras that `boresight export` writes: the checks `of_exports` and `of_headers`, which check.py runs.

    python tests/interop/exchange.py --freeze tests/fixtures/exchange

writes cameras with the programs' own writers into that folder, and beside each, as NAME.csv, where the program itself puts directions:
tests/it/exchange.rs imports the one and is held to the other.
"""
import json
import os
import subprocess
import sys

import numpy as np

CAMERAS = {
    "narrow": dict(width_px=1024, height_px=768, principal_point_px=[510.0, 408.0], focal_length_px=5114.0, k1=3.8e-9, p1=0.0, p2=0.0),
    "wide": dict(width_px=2048, height_px=1536, principal_point_px=[1023.5, 767.5], focal_length_px=4619.0, k1=-0.15 / 4619.0**2, p1=0.0, p2=0.0),
    "mirrored": dict(parity=-1, width_px=1280, height_px=1024, principal_point_px=[655.25, 498.5], focal_length_px=2400.0, k1=1.5e-8, p1=4e-8, p2=-7e-8),
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


def near(there, pixel, stated):
    """Points of another program against ours: not further off than the export said."""
    distance = np.hypot(*(there - pixel).T)
    assert distance.max() <= stated + 1e-6, f"{distance.max():.3e} px, and {stated:.3e} px were stated"
    return f"rms {np.sqrt((distance**2).mean()):.1e} px, at most {distance.max():.1e} px, stated {stated:.1e} px"


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
    script = os.path.join(os.path.dirname(os.path.abspath(__file__)), "mrcal_points.py")
    python = os.environ.get("MRCAL_PYTHON", sys.executable)
    done = subprocess.run([python, script, path], input=json.dumps(direction.tolist()), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return np.array(json.loads(done.stdout))


def tetra3rs_points(path, direction):
    """The file as its own program reads it."""
    import tetra3rs
    model = tetra3rs.CameraModel.load_from_file(path)
    points = [model.tanplane_to_pixel(x / z, y / z) for x, y, z in direction]
    return np.array(points) + (np.array([model.image_width, model.image_height]) - 1) / 2


def cedar_points(path, direction):
    """tetra3's own equations (tetra3.py, _undistort_centroids), inverted here in double precision."""
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
    return measured - 0.5


FORWARD = {"opencv": opencv, "ros": ros, "mrcal": mrcal_points, "tetra3rs": tetra3rs_points, "tetra3": cedar_points}


def rotation(quaternion):
    from scipy.spatial.transform import Rotation
    return Rotation.from_quat(quaternion).as_matrix()


def of_headers(program, calibration, folder):
    """Headers of the light as it arrives, through astropy: the camera's own map, turned by each frame's attitude."""
    from astropy.io import fits
    from astropy.wcs import WCS

    told = json.load(open(calibration))
    attitudes = {f["frame"]: f["camera_from_icrs"] for f in told["per_frame"] if f["camera_from_icrs"]}
    focal = told["camera"]["focal_length_px"]
    pixel, direction = our_map(program, calibration)
    said = []
    for format in ("sip", "tpv"):
        into = os.path.join(folder, format)
        result = json.loads(run(program, "export", calibration, "--to", format, "--wcs", "apparent", "-o", into, "--json"))
        stated, most = result["residual"]["max_px"], 0.0
        for file, (frame, attitude) in zip(result["files"], sorted(attitudes.items()), strict=True):
            assert file.endswith(f"frame-{frame:04}.wcs"), file
            wcs = WCS(fits.getheader(file))
            ra, dec = np.radians(wcs.all_pix2world(pixel, 0)).T
            sky = np.array([np.cos(ra) * np.cos(dec), np.sin(ra) * np.cos(dec), np.sin(dec)])
            ours = rotation(attitude).T @ (direction.T)
            angle = np.arctan2(np.linalg.norm(np.cross(sky.T, ours.T), axis=1), (sky * ours).sum(axis=0)) * focal
            most = max(most, angle.max())
            world = np.degrees(np.array([ra, dec])).T
            back = np.hypot(*(wcs.all_world2pix(world, 0, tolerance=1e-9) - pixel).T).max()
            assert back < 1e-6, f"{format}, frame {frame}: back to the pixel {back:.1e} px"
            if format == "sip" and wcs.sip is not None and wcs.sip.ap is not None:
                plane = wcs.wcs_world2pix(world, 0)
                by_ap = np.hypot(*(plane + ap(wcs, plane) - pixel).T).max()
                assert by_ap <= result["inverse_max_px"] + 1e-3, f"AP and BP, frame {frame}: {by_ap:.1e} px"
        # A grid over the frame's corners may lie between the points that the statement was made on.
        assert most <= 1.2 * stated + 1e-6, f"{format}: {most:.1e} px, and {stated:.1e} px were stated"
        said.append(f"{format} {most:.1e} px")
    return ", ".join(said)


def ap(wcs, plane):
    """SIP's AP and BP on a pixel without distortion (counted from 0)."""
    u, v = (plane - (wcs.wcs.crpix - 1)).T
    sum_of = lambda m: sum(m[i, j] * u**i * v**j for i in range(len(m)) for j in range(len(m)))
    return np.array([sum_of(wcs.sip.ap), sum_of(wcs.sip.bp)]).T


def csv(path, header, rows):
    with open(path, "w") as out:
        out.write(header + "\n")
        out.writelines(",".join(repr(float(value)) for value in row) + "\n" for row in rows)


def freeze(folder):
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 7), np.linspace(0, 479, 5)), -1).reshape(-1, 2)
    f, c = 1210.0, np.array([322.5, 236.25])
    ray = np.column_stack([(grid - c) / f * 0.97, np.ones(len(grid))])
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    k, d8 = np.array([[f, 0, c[0]], [0, f, c[1]], [0, 0, 1]]), [-0.11, 0.04, 3e-4, -2e-4, 0.02, 0.01, -0.02, 0.005]
    at = lambda name: os.path.join(folder, name)
    forward = "x,y,z,x_px,y_px"
    import cv2
    for name, fisheye in (("opencv.yml", False), ("opencv_fisheye.yml", True)):
        storage = cv2.FileStorage(at(name), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 640)
        storage.write("image_height", 480)
        if fisheye:
            storage.write("distortion_model", "fisheye")
        storage.write("camera_matrix", k)
        d = np.array([0.02, -0.01, 0.004, -0.001] if fisheye else d8)
        storage.write("distortion_coefficients", d.reshape(-1, 1))
        storage.release()
        project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
        there = project(ray.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), k, d)[0].reshape(-1, 2)
        csv(at(name + ".csv"), forward, np.column_stack([ray, there]))
    import mrcal
    intrinsics = np.array([f, f * 1.001, *c, *d8])
    mrcal.cameramodel(intrinsics=("LENSMODEL_OPENCV8", intrinsics), imagersize=(640, 480)).write(at("mrcal.cameramodel"))
    csv(at("mrcal.cameramodel.csv"), forward, np.column_stack([ray, mrcal.project(ray, "LENSMODEL_OPENCV8", intrinsics)]))
    import tetra3rs
    radial = dict(k1=-6e-8, k2=1.2e-14, k3=0.0, p1=3e-7, p2=-2e-7, center=[0.0, 0.0])
    camera = dict(focal_length_px=f, image_width=640, image_height=480, crpix=[3.0, -3.25], parity_flip=True, distortion={"Radial": radial})
    json.dump(camera, open(at("tetra3rs.json"), "w"), indent=1)
    distortion = tetra3rs.RadialDistortion(*(radial[k] for k in ("k1", "k2", "k3", "p1", "p2")))
    model = tetra3rs.CameraModel(f, 640, 480, crpix=camera["crpix"], parity_flip=True, distortion=distortion)
    model.save_to_file(at("tetra3rs.camera"))
    there = tetra3rs_points(at("tetra3rs.camera"), ray)
    for name in ("tetra3rs.json", "tetra3rs.camera"):
        csv(at(name + ".csv"), forward, np.column_stack([ray, there]))
    from astropy.io import fits
    from astropy.wcs import WCS
    cd = np.degrees(1 / f) * np.array([[-0.8, 0.6], [0.6, 0.8]])  # mirrored
    for name, kind in (("sip.wcs", "TAN-SIP"), ("tpv.wcs", "TPV")):
        header = fits.Header(dict(NAXIS=2, NAXIS1=640, NAXIS2=480, CTYPE1="RA---" + kind, CTYPE2="DEC--" + kind, CUNIT1="deg", CUNIT2="deg"))
        header.update(dict(CRPIX1=c[0] + 1, CRPIX2=c[1] + 1, CRVAL1=83.8, CRVAL2=-5.4, CD1_1=cd[0, 0], CD1_2=cd[0, 1], CD2_1=cd[1, 0], CD2_2=cd[1, 1]))
        k1, p1 = 4e-8, 3e-7
        if kind == "TPV":
            scale = f**2 * np.radians(1) ** 2 * -k1
            header.update({f"PV{axis}_{index}": value for axis in (1, 2) for index, value in ((1, 1.0), (7, scale), (9, scale))})
        else:
            header.update(dict(A_ORDER=3, A_3_0=-k1, A_1_2=-k1, A_2_0=-3 * p1, A_0_2=-p1, B_ORDER=3, B_0_3=-k1, B_2_1=-k1, B_1_1=-2 * p1))
        header.totextfile(at(name), overwrite=True)
        sky = WCS(fits.Header.fromtextfile(at(name))).all_pix2world(grid, 0)
        csv(at(name + ".csv"), "x_px,y_px,ra_deg,dec_deg", np.column_stack([grid, sky]))


def placed(template, name, folder):
    """A calibration with this camera, its attitudes those of the template; and its file."""
    camera = CAMERAS[name]
    calibration = json.load(open(template))
    calibration["chain"] = None
    calibration["parity"] = camera.get("parity", 1)
    calibration["camera"] = {key: value for key, value in camera.items() if key != "parity"}
    path = os.path.join(folder, f"{name}.json")
    json.dump(calibration, open(path, "w"))
    return path


def of_exports(program, template, folder, name, format):
    """One camera in one format: where its program puts the directions of our map."""
    path = placed(template, name, folder)
    pixel, direction = our_map(program, path)
    file = os.path.join(folder, f"{name}.{format}")
    result = json.loads(run(program, "export", path, "--to", format, "-o", file, "--json", "--inexact", "--force"))
    there = FORWARD[format](file, direction)
    mirrored = CAMERAS[name].get("parity", 1) < 0
    if mirrored and format != "tetra3rs":  # of the un-mirrored image, as the file says
        there = np.array([CAMERAS[name]["width_px"] - 1, 0]) + there * [-1, 1]
    return near(there, pixel, result["residual"]["max_px"])


if __name__ == "__main__":
    if len(sys.argv) != 3 or sys.argv[1] != "--freeze":
        sys.exit(__doc__)
    freeze(sys.argv[2])
