#!/usr/bin/env python3
"""Gain, read noise and bias that a recording's own pixels tell, against those that it was rendered with.

Presets under three levels of the sky's light are rendered to PNG; gain, bias and read noise are then taken out of recording.toml, and `boresight diagnose`
(of a fisheye `boresight calibrate`) has to say them: the gain, and the line on which read noise and bias lie. Beside each error of the gain stands its
Cramer-Rao bound by the variances of the pixels of all stars above SNR 5, their light, place and level free, their images known.

Takes the program alone: gain.py PROGRAM FOLDER PAGE [--seeds N] [--commit C].
"""
import argparse
import json
import math
import pathlib
import re
import shutil
import subprocess
import sys

PRESETS = ["machine-vision-35mm", "cubesat-tracker", "raspberry-pi-hq", "meteor-camera"]
SKIES = [0.3, 1.0, 3.0]


def run(*command):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True)
    if done.returncode not in (0, 3):
        sys.exit(f"{' '.join(map(str, command))}: {done.stderr.strip()}")
    return done.stdout


def number(text, key):
    return float(re.search(rf"^{key}\s*=\s*([-+.\deE_]+)", text, re.M)[1])


def scene(program, preset, sky, seed):
    """The preset with so much of its sky's light and this seed."""
    text = run(program, "preset", "show", preset)
    level = number(text, "background_e_per_px_s")
    for key, value in [("background_e_per_px_s", level * sky), ("seed", seed)]:
        text = re.sub(rf"^{key}\s*=.*$", f"{key} = {value}", text, flags=re.M)
    return text


def along(at, sigma, reach):
    """What the pixels along an axis get of a Gaussian, and its derivative by the place."""
    root = sigma * math.sqrt(2)
    edges = [round(at) - reach + k - 0.5 - at for k in range(2 * reach + 2)]
    cut, slope = [0.5 * math.erf(edge / root) for edge in edges], [math.exp(-((edge / root) ** 2)) / (root * math.sqrt(math.pi)) for edge in edges]
    return [(cut[k + 1] - cut[k], slope[k] - slope[k + 1]) for k in range(2 * reach + 1)]


def solved(matrix, right):
    """Gauss's elimination of a small positive definite system."""
    rows = [list(row) + [value] for row, value in zip(matrix, right)]
    for k, pivot in enumerate(rows):
        for row in rows[k + 1 :]:
            share = row[k] / pivot[k]
            row[k:] = [a - share * b for a, b in zip(row[k:], pivot[k:])]
    for k in reversed(range(len(rows))):
        rows[k] = (rows[k][-1] - sum(rows[k][j] * rows[j] for j in range(k + 1, len(rows)))) / rows[k][k]
    return rows


def star_information(light, rows, quiet, per_dn):
    """Fisher information of the variance per count in what a fit of light, level and place (`rows`) leaves of a star's pixels."""
    variance = [quiet + per_dn * value for value in light]
    normal = [[sum(row[a] * row[b] / v for row, v in zip(rows, variance)) for b in range(4)] for a in range(4)]
    total = 0.0
    for k, own in enumerate(rows):
        if light[k] < 0.01 * max(light):
            continue
        lever = solved(normal, own)
        left = lit = 0.0
        for j, other in enumerate(rows):
            share = ((j == k) - sum(a * b for a, b in zip(lever, other)) / variance[j]) ** 2
            left, lit = left + share * variance[j], lit + share * light[j]
        total += 0.5 * (lit / left) ** 2
    return total


def bound(folder, text):
    """Cramer-Rao bound of the gain, relative: by the variances of star pixels, their light, place and level free, the noise of the sky known."""
    gain, bias, read, full = (number(text, key) for key in ["gain_e_per_dn", "bias_dn", "read_noise_e", "saturation_dn"])
    sigma, exposure, sky = (number(text, key) for key in ["psf_sigma_px", "exposure_s", "background_e_per_px_s"])
    quiet = (read * read + sky * exposure) / gain**2 + 1 / 12
    top = min((full - bias) * gain, number(text, "full_well_e")) - sky * exposure
    reach = math.ceil(3.5 * sigma)
    information = 0.0
    with open(folder / "truth" / "stars.csv", encoding="utf-8") as lines:
        names = next(lines).strip().split(",")
        x, y, flux, snr = (names.index(name) for name in ["x_px", "y_px", "electrons_landed", "snr"])
        for line in lines:
            own = line.split(",")
            across, down = along(float(own[x]), sigma, reach), along(float(own[y]), sigma, reach)
            dn = float(own[flux]) / gain
            rows = [[u * v, 1.0, dn * slope * v, dn * u * fall] for v, fall in down for u, slope in across]
            light = [dn * row[0] for row in rows]
            if float(own[snr]) > 5 and max(light) < top / gain:
                information += star_information(light, rows, quiet, 1 / gain)
    return gain / math.sqrt(information) if information > 0 else math.inf


def declare_nothing(folder):
    """The recording without the numbers of its detector."""
    file = folder / "recording.toml"
    kept = [line for line in file.read_text().splitlines() if not re.match(r"(gain_e_per_dn|bias_dn|read_noise_e)\s*=", line)]
    file.write_text("\n".join(kept) + "\n")


def told(program, folder, is_fisheye):
    """What the program says of the detector: name -> (value, sigma), and its sentence."""
    verb = ["calibrate"] if is_fisheye else ["diagnose", "--nulls", "20"]
    result = json.loads(run(program, *verb, folder, "--physics", "known", "--json"))
    own = result.get("detector") if is_fisheye else next((e for e in result["effects"] if e["id"] == "gain-noise"), None)
    own = own or {"parameters": [], "reason": "nothing"}
    return {p["name"]: (p["value"], p["sigma"]) for p in own["parameters"]}, own["reason"]


def cell(found, key, truth):
    if key not in found:
        return "cannot tell"
    value, sigma = found[key]
    return f"{value:.4g} ± {sigma:.2g} ({100 * (value / truth - 1):+.1f} %)"


def on_line(reason, truth):
    """Read noise at the true bias, and bias at the true read noise, on the line that is told."""
    line = re.search(r"= (-?[\d.]+) \+ ([\d.]+)·\(bias", reason)
    if not line:
        return ["–", "–"]
    at_no_bias, slope = float(line[1]), float(line[2])
    square, read = at_no_bias + slope * truth["bias_dn"], truth["read_noise_e"]
    noise = f"{math.sqrt(square):.2f} ({100 * (math.sqrt(square) / read - 1):+.1f} %)" if square > 0 else "below zero"
    bias = (read * read - at_no_bias) / slope
    return [noise, f"{bias:.1f} ({bias - truth['bias_dn']:+.1f})"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("page", type=pathlib.Path)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--presets", nargs="*", default=PRESETS)
    parser.add_argument("--commit", default="unknown")
    given = parser.parse_args()
    rows, met = [], [0, 0]
    for preset in given.presets:
        for sky in SKIES:
            for seed in range(1, given.seeds + 1):
                text = scene(given.program, preset, sky, seed)
                folder = given.folder / f"{preset}-{sky:g}-{seed}"
                shutil.rmtree(folder, ignore_errors=True)
                folder.parent.mkdir(parents=True, exist_ok=True)
                file = folder.with_suffix(".toml")
                file.write_text(text)
                run(given.program, "simulate", file, "-o", folder, "--image-format", "png16")
                is_fisheye = "projection" in text
                truth = {key: number(text, key) for key in ["gain_e_per_dn", "bias_dn", "read_noise_e"]}
                limit = bound(folder, text)
                declare_nothing(folder)
                nothing, reason = told(given.program, folder, is_fisheye)
                gain = nothing.get("gain_e_per_dn")
                is_met = gain is not None and abs(gain[0] / truth["gain_e_per_dn"] - 1) <= max(0.02, 2 * limit)
                met = [met[0] + is_met, met[1] + 1]
                row = [preset, f"{sky:g}", str(seed), cell(nothing, "gain_e_per_dn", truth["gain_e_per_dn"]), f"{100 * limit:.1f} %"]
                row += ["yes" if is_met else "no", *on_line(reason, truth)]
                rows.append(row)
                print(" | ".join(row), "|", reason, file=sys.stderr, flush=True)
                shutil.rmtree(folder)
    head = ["preset", "sky ×", "seed", "gain, e/DN, nothing declared", "bound", "within max(2 %, 2 × bound)"]
    head += ["read noise at the true bias, e", "bias at the true read noise, DN"]
    lines = ["# Gain, read noise and bias from a recording's own pixels", "", f"Written by `make bench-gain`; commit {given.commit}.", ""]
    lines += [f"Presets as they are, under their sky's light times the factor: {met[0]} of {met[1]} gains within the limit.", ""]
    lines += ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)] + ["| " + " | ".join(row) + " |" for row in rows]
    given.page.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
