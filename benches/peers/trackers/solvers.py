"""tetra3rs and cedar-solve as systems under test: a line of JSON in for each frame, a line out. `python solvers.py tetra3rs|cedar WIDTH_DEG`."""

import json
import sys
import time
from datetime import datetime

import numpy as np
from PIL import Image


def tetra3rs_solver(width_deg: float):
    """A function from the counts of a frame (rows, columns) and its time to an answer, by tetra3rs."""
    import tetra3rs

    database = tetra3rs.SolverDatabase.generate_from_gaia(max_fov_deg=1.2 * width_deg, min_fov_deg=0.8 * width_deg, epoch_proper_motion_year=2026.2)

    def solve(counts: np.ndarray, time_utc: str) -> dict:
        # Its default of 5 sigma takes noise of these frames for stars by the hundred, some of them the brightest: then it finds no match.
        found = tetra3rs.extract_centroids(counts.astype(np.float32), sigma_threshold=15.0)
        velocity = list(tetra3rs.earth_barycentric_velocity(datetime.fromisoformat(time_utc)))
        solved = database.solve_from_centroids(
            found.centroids, fov_estimate_deg=width_deg, fov_max_error_deg=0.1 * width_deg, image_shape=counts.shape, observer_velocity_km_s=velocity
        )
        if not isinstance(solved, tetra3rs.SolveResult):
            return {"status": "none"}
        # Scalar first, from ICRS to camera axes.
        return {"status": "solved", "quaternion": [float(own) for own in solved.quaternion]}

    return solve


def cedar_solver(width_deg: float):
    """A function from the counts of a frame (rows, columns) and its time to an answer, by cedar-solve."""
    import tetra3

    solver = tetra3.Tetra3()

    def solve(counts: np.ndarray, _: str) -> dict:
        stars = tetra3.get_centroids_from_image(Image.fromarray(counts), sigma=3, filtsize=25, max_area=400)
        if len(stars) < 4:
            return {"status": "none"}
        answer = solver.solve_from_centroids(stars, counts.shape, fov_estimate=width_deg, fov_max_error=0.1 * width_deg, solve_timeout=5000)
        if answer["RA"] is None:
            return {"status": "none"}
        # Its roll counts to celestial north, toward the left; ours is the position angle of the upward direction.
        return {"status": "solved", "ra_deg": float(answer["RA"]), "dec_deg": float(answer["Dec"]), "roll_deg": -float(answer["Roll"])}

    return solve


def main() -> None:
    """Answers every line of stdin."""
    solve = {"tetra3rs": tetra3rs_solver, "cedar": cedar_solver}[sys.argv[1]](float(sys.argv[2]))
    for line in sys.stdin:
        asked = json.loads(line)
        counts = np.asarray(Image.open(asked["image"]))
        begin = time.perf_counter()
        print(json.dumps({"frame": asked["frame"], **solve(counts, asked["time_utc"]), "time_s": time.perf_counter() - begin}), flush=True)


main()
