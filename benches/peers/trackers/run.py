"""tetra3rs, cedar-solve, astrometry.net and, where LOST_BIN names it, LOST through one suite beside boresight: a page of figures.

`python run.py BORESIGHT FRAMES PAGE [NOTE]`. A program that is not there is named as left out.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
WIDTH_DEG = 13.9

SYSTEMS = {
    "boresight (windowed)": '[own]\ncentroid = "windowed"\n',
    "boresight (fitted)": '[own]\ncentroid = "gaussian"\n',
    "tetra3rs": f"""[system]
name = "tetra3rs"
command = [{json.dumps(sys.executable)}, {json.dumps(str(HERE / "solvers.py"))}, "tetra3rs", "{WIDTH_DEG}"]
mode = "stream"
image = "png16"
timeout_s = 60
answer = "json"
warm_up = 2
[system.conventions]
quaternion = "wxyz"
""",
    "cedar-solve": f"""[system]
name = "cedar-solve"
command = [{json.dumps(sys.executable)}, {json.dumps(str(HERE / "solvers.py"))}, "cedar", "{WIDTH_DEG}"]
mode = "stream"
image = "png16"
timeout_s = 60
answer = "json"
warm_up = 2
""",
    "astrometry.net": f"""[system]
name = "astrometry.net"
command = ["sh", {json.dumps(str(HERE / "solve_field.sh"))}, "{{image}}", "{{answer}}", "{WIDTH_DEG}"]
mode = "frame"
image = "fits"
timeout_s = 60
answer = "astrometry-wcs"
""",
    "LOST": f"""[system]
name = "LOST"
command = ["sh", {json.dumps(str(HERE / "lost.sh"))}, "{{image}}", "{{answer}}", "{WIDTH_DEG}"]
mode = "frame"
image = "png8"
scaling = {{ black_dn = 0, white_dn = 400 }}
timeout_s = 60
answer = "lost"
""",
}


def missing(name: str) -> str | None:
    """Why a system cannot be run, if it cannot."""
    if name == "tetra3rs" or name == "cedar-solve":
        module = {"tetra3rs": "tetra3rs", "cedar-solve": "tetra3"}[name]
        found = subprocess.run([sys.executable, "-c", f"import {module}"], capture_output=True)
        return None if found.returncode == 0 else f"the Python module {module} is not installed"
    if name == "astrometry.net":
        return None if shutil.which("solve-field") else "there is no solve-field"
    if name == "LOST":
        return None if os.environ.get("LOST_BIN") else "LOST_BIN names no program"
    return None


def row(name: str, boresight: str, frames: int) -> str:
    """The figures of a system as a row of the page."""
    why = missing(name)
    if why:
        return f"| {name} | left out: {why} | | | | | | |"
    cases = (HERE / "cases.toml").read_text().replace("FRAMES", str(frames))
    with tempfile.TemporaryDirectory() as folder:
        suite = Path(folder) / "suite.toml"
        suite.write_text(f'format = "boresight-suite/1"\nseed = 1\n{SYSTEMS[name]}\n{cases}')
        shutil.copy(HERE / "scene.toml", folder)
        run = subprocess.run([boresight, "test", str(suite), "--json", "--quiet"], capture_output=True, text=True)
        if run.returncode not in (0, 3):
            return f"| {name} | failed: {run.stderr.strip()} | | | | | | |"
    value = json.loads(run.stdout)["cases"][0]["values"][0]
    measured = {own["metric"]: own["value"] for own in value["measured"]}
    required = {own["metric"]: own for own in value["requirements"]}
    right, wrong = measured["acquisition.correct_rate"], measured["acquisition.false_rate"]
    rms = (required["attitude.cross_boresight_arcsec.rms"].get("measured") or {}).get("value")
    p95 = measured.get("attitude.cross_boresight_arcsec.p95")
    number = lambda own: "–" if own is None else f"{own:.1f}"
    faults = "; ".join(fault["sentence"] for fault in value["faults"]) or "–"
    return (
        f"| {name} | {value['frames']} | {100 * right:.1f} % | {100 * wrong:.1f} % | {100 * (1 - right - wrong):.1f} % | {number(rms)} | {number(p95)} "
        f"| {1000 * measured['latency_s.p50']:.0f} | {faults} |"
    )


def main() -> None:
    """Runs all systems and writes the page."""
    boresight, frames, page = sys.argv[1], int(sys.argv[2]), Path(sys.argv[3])
    rows = []
    for name in SYSTEMS:
        rows.append(row(name, boresight, frames))
        print(rows[-1], flush=True)
    note = " " + sys.argv[4] if len(sys.argv) > 4 else ""
    version = subprocess.run([boresight, "--version"], capture_output=True, text=True).stdout.strip()
    page.write_text(
        "# Star trackers through one suite\n\n"
        f"`make trackers` ({version}): {frames} frames of 1024², {WIDTH_DEG} degrees wide, by chance over the sky, the same for all; right within 120 arcsec. Stellar aberration is in the\n"
        "frames: cedar-solve and astrometry.net leave it out by design, and the suite names it. The latency of a program that is started for each frame (astrometry.net, LOST)\n"
        f"has its start in it; that of boresight is without the image file.{note}\n\n"
        "| system | frames | right | wrong | none | boresight rms/arcsec | p95/arcsec | latency p50/ms | faults named |\n|---|---|---|---|---|---|---|---|---|\n"
        + "\n".join(rows)
        + "\n"
    )


main()
