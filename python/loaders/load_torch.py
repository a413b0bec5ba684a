"""A dataset with torch: `DataLoader(Frames("DIR", "train"), batch_size=8, num_workers=4)` gives images and maps of distances to stars."""

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from PIL import Image


def decoded(name: str, data: bytes):
    """A member; counts as float32, which holds 16 bits exactly: torch before 2.3 has no uint16."""
    if name.endswith("json"):
        return json.loads(data)
    if name.endswith("fits"):
        from astropy.io import fits  # needed for image = "fits-rice" alone

        pixels = fits.getdata(io.BytesIO(data), 1)
    else:
        pixels = np.load(io.BytesIO(data)) if name.endswith("npy") else np.asarray(Image.open(io.BytesIO(data)))
    return torch.from_numpy(pixels.astype(np.uint8 if pixels.dtype == np.uint8 else np.float32))


class Frames(torch.utils.data.IterableDataset):
    """Every sample of a split once, whatever the number of workers: each takes every so-manieth shard, and one without a shard gives nothing."""

    def __init__(self, folder: str | Path, split: str, members: tuple[str, ...] = ("image", "distance")):
        self.shards, self.members = sorted(Path(folder, split).glob("*.tar")), members

    def __iter__(self) -> Iterator[dict]:
        worker = torch.utils.data.get_worker_info()
        first, step = (worker.id, worker.num_workers) if worker else (0, 1)
        for shard in self.shards[first::step]:
            sample: dict = {}
            with tarfile.open(shard) as archive:
                for entry in archive:
                    key, _, name = entry.name.partition(".")
                    if sample and sample["key"] != int(key):
                        yield sample
                        sample = {}
                    sample["key"] = int(key)
                    if name.partition(".")[0] in self.members:
                        sample[name.partition(".")[0]] = decoded(name, archive.extractfile(entry).read())
            yield sample
