"""A dataset with Hugging Face's datasets: `load("DIR", "train")`, or `load("DIR", "train", streaming=True)`.

The types are stated. Those that `datasets` guesses from the first samples are wrong where these have no star.
"""

import json
from pathlib import Path

import datasets
from datasets import Features, Image, Sequence, Value

REALS = """x_px y_px x_mid_px y_mid_px x_start_px y_start_px x_end_px y_end_px x_ideal_px y_ideal_px crlb_x_px crlb_y_px
    magnitude colour electrons_asked electrons_landed peak_electrons background_e snr""".split()
WHOLE = ["hip", "box_left_px", "box_top_px", "box_right_px", "box_bottom_px"]
LIGHTS = (
    dict.fromkeys(REALS, "float64")
    | dict.fromkeys(WHOLE, "int64")
    | dict.fromkeys(["visible", "saturated", "blended", "edge"], "bool")
    | {"kind": "string"}
)
VALUES = (
    dict.fromkeys("key camera recording pair".split(), "int64")
    | dict.fromkeys("format split scene_sha256 time_utc projection psf background_file pixels_sha256".split(), "string")
    | dict.fromkeys("tai_minus_utc_s exposure_s line_time_s focal_length_px psf_sigma_px gain_e_per_dn bias_dn read_noise_e".split(), "float64")
    | dict.fromkeys("full_well_e saturation_dn background_e_per_px_s temperature_c saturated_share".split(), "float64")
    | {"no_stars": "bool", "seed": "uint64"}
)
LISTS = {
    "size_px": (2, "int64"),
    "rate_deg_s": (3, "float64"),
    "velocity_km_s": (3, "float64"),
    "principal_point_px": (2, "float64"),
    "distortion": (3, "float64"),
}
LISTS |= {f"camera_from_icrs_{when}": (4, "float64") for when in ("start", "mid", "end")}


def features(folder: str | Path) -> Features:
    """Types of a sample, by what dataset.json says that it has."""
    said = json.loads(Path(folder, "dataset.json").read_text())
    labels = {name: Value(kind) for name, kind in VALUES.items()} | {
        name: Sequence(Value(kind), length=length) for name, (length, kind) in LISTS.items()
    }
    labels |= {"effects": Sequence(Value("string")), "lights": {name: Sequence(Value(kind)) for name, kind in LIGHTS.items()}}
    if said["image"] != "png16" or "clean" in said["members"]:
        raise ValueError("datasets reads PNG members alone: take load_numpy, load_webdataset or load_torch")
    images = {f"{name}.png": Image() for name in ("image", *said["members"])}
    return Features({"__key__": Value("string"), "__url__": Value("string"), "json": labels} | images)


def load(folder: str | Path, split: str, **more):
    """A split; `more`: what load_dataset takes, as streaming=True or cache_dir."""
    shards = [str(path) for path in sorted(Path(folder, split).glob("*.tar"))]
    return datasets.load_dataset("webdataset", data_files={split: shards}, split=split, features=features(folder), **more)
