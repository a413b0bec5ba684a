"""A dataset with webdataset: `for sample in pipeline("DIR", "train"): sample["image.png"]`."""

import io
import json
from pathlib import Path

import numpy as np
import webdataset
from PIL import Image


def decoded(name: str, data: bytes):
    """A member as it is stored. webdataset's own decoders make 8 bits of the 16 of an image: every count from 255 on becomes 255."""
    if name.endswith(".json"):
        return json.loads(data)
    if name.endswith(".npy"):
        return np.load(io.BytesIO(data))
    if name.endswith(".fits"):
        from astropy.io import fits  # needed for image = "fits-rice" alone

        return fits.getdata(io.BytesIO(data), 1).astype(np.uint16)
    return np.asarray(Image.open(io.BytesIO(data))) if name.endswith(".png") else None


def pipeline(folder: str | Path, split: str, **more) -> webdataset.WebDataset:
    """Samples of a split; `more`: what WebDataset takes, as shardshuffle=100. It wants at least as many shards as there are workers."""
    shards = [str(path) for path in sorted(Path(folder, split).glob("*.tar"))]
    return webdataset.WebDataset(shards, **({"shardshuffle": False} | more)).decode(decoded)
