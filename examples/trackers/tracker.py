"""A star tracker in Python as a system under test: a line of JSON in for each frame, a line out for its answer. Nothing but the standard library.

It calls `boresight identify` for the work, in the place of a tracker of your own: replace `solve`.
"""

import json
import subprocess
import sys


def solve(image: str, boresight: str) -> dict:
    """The answer to an image: status, and the quaternion camera_from_icrs, scalar last."""
    run = subprocess.run([boresight, "identify", image, "--json", "--quiet", "--centroid", "windowed"], capture_output=True, text=True)
    if run.returncode not in (0, 3):
        return {"status": "error", "error": run.stderr.strip()[-200:]}
    frame = json.loads(run.stdout)["frames"][0]
    if frame["status"] != "identified":
        return {"status": "none"}
    return {"status": "solved", "quaternion": frame["camera_from_icrs"]}


def main() -> None:
    """Answers every line of stdin; the first argument is the program that does the work."""
    boresight = sys.argv[1] if len(sys.argv) > 1 else "boresight"
    for line in sys.stdin:
        asked = json.loads(line)
        print(json.dumps({"frame": asked["frame"], **solve(asked["image"], boresight)}), flush=True)


main()
