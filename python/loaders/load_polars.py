"""All lights of a split as one table of polars: `lights("DIR", "train").filter(polars.col("snr") > 50)`."""

import json
import tarfile
from pathlib import Path

import polars

REALS = """x_px y_px x_mid_px y_mid_px x_start_px y_start_px x_end_px y_end_px x_ideal_px y_ideal_px crlb_x_px crlb_y_px
    magnitude colour electrons_asked electrons_landed peak_electrons background_e snr""".split()
WHOLE = ["hip", "box_left_px", "box_top_px", "box_right_px", "box_bottom_px"]
# Stated, for a frame without a star tells no types.
TYPES = (
    dict.fromkeys(REALS, polars.Float64)
    | dict.fromkeys(WHOLE, polars.Int64)
    | dict.fromkeys(["visible", "saturated", "blended", "edge"], polars.Boolean)
)
TYPES |= {"kind": polars.String}


def lights(folder: str | Path, split: str) -> polars.DataFrame:
    """One row for each light; `key`: the number of its frame."""
    frames = []
    for shard in sorted(Path(folder, split).glob("*.tar")):
        with tarfile.open(shard) as archive:
            for entry in archive:
                if entry.name.endswith(".json"):
                    labels = json.load(archive.extractfile(entry))
                    frames.append(polars.DataFrame(labels["lights"], schema_overrides=TYPES).with_columns(polars.lit(labels["key"]).alias("key")))
    return polars.concat(frames)
