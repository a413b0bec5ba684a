"""Samples of a dataset with numpy and Pillow alone (and astropy for FITS): `for sample in samples("DIR", "train"): sample["image"]`."""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image


def decoded(name: str, data: bytes):
    """A member of a sample: labels as a dictionary, images as they are stored: uint16 counts, uint8 masks and distances, float32 electrons."""
    if name.endswith("json"):
        return json.loads(data)
    if name.endswith("fits"):
        from astropy.io import fits  # needed for image = "fits-rice" alone

        return fits.getdata(io.BytesIO(data), 1).astype(np.uint16)
    return np.load(io.BytesIO(data)) if name.endswith("npy") else np.asarray(Image.open(io.BytesIO(data)))


def samples(folder: str | Path, split: str) -> Iterator[dict]:
    """Every sample of a split: `key`, `image`, `json` and the other members that it has."""
    for shard in sorted(Path(folder, split).glob("*.tar")):
        sample: dict = {}
        with tarfile.open(shard) as archive:
            for entry in archive:
                key, _, name = entry.name.partition(".")
                if sample and sample["key"] != key:
                    yield sample
                    sample = {}
                sample["key"] = key
                sample[name.partition(".")[0]] = decoded(name, archive.extractfile(entry).read())
        yield sample
