"""Trains the network on a dataset of `boresight dataset`: train.py DIR NETWORK.pt [SECONDS], of processor time. Prints what it finds on the split
it has not seen."""

import io
import json
import sys
import tarfile
import time
from pathlib import Path

import numpy as np
import torch
from network import StarNetwork, flattened
from PIL import Image

FALSE_PER_MEGAPIXEL = 1.0  # of the threshold: as `boresight detect` has it, one false star a frame
NEAR_PX = 1.0
BATCH, CROP_PX = 64, 64  # of parts of frames


def samples(folder: Path, split: str):
    """Images (DN) and labels of a split, in order."""
    for shard in sorted((folder / split).glob("*.tar")):
        with tarfile.open(shard) as archive:
            sample = {}
            for entry in archive:
                sample[entry.name.partition(".")[2]] = archive.extractfile(entry).read()
                if "json" in sample and "image.png" in sample:
                    yield np.asarray(Image.open(io.BytesIO(sample["image.png"]))), json.loads(sample["json"])
                    sample = {}


def targets(labels: dict, size: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Likeness to a star's pixel (1 at the pixel of a centre), offsets of centres, and what counts: pixels of stars that are too faint do not."""
    height, width = size
    like, offsets, counts = np.zeros(size, np.float32), np.zeros((2, *size), np.float32), np.ones(size, np.float32)
    lights = labels["lights"]
    rows, columns = np.mgrid[0:height, 0:width]
    for x, y, snr, visible in zip(lights["x_px"], lights["y_px"], lights["snr"], lights["visible"]):
        column, row = round(x), round(y)
        window = np.s_[max(row - 3, 0) : max(row + 4, 0), max(column - 3, 0) : max(column + 4, 0)]
        if like[window].size == 0:
            continue
        if not visible:
            if snr > 2.0:
                counts[window] = 0.0
            continue
        distance2 = (columns[window] - x) ** 2 + (rows[window] - y) ** 2
        like[window] = np.maximum(like[window], np.exp(-distance2 / (2 * 0.7**2)))
        if 0 <= row < height and 0 <= column < width:
            like[row, column], counts[row, column] = 1.0, 1.0
            offsets[:, row, column] = x - column, y - row
    return like, offsets, counts


def loss(network: StarNetwork, images, like, offsets, counts) -> torch.Tensor:
    """Focal loss of the likeness (Lin et al. 2017, in the form of CornerNet), and the distance between centres."""
    logits, found = network(images)
    chance = torch.sigmoid(logits).clamp(1e-6, 1 - 1e-6)
    is_star = like == 1.0
    of_stars = -((1 - chance) ** 2 * torch.log(chance))[is_star].sum()
    others = -((1 - like) ** 4 * chance**2 * torch.log(1 - chance) * counts)[~is_star].sum()
    apart = (torch.abs(found - offsets).sum(1) * is_star).sum()
    return (of_stars + others + apart) / is_star.sum().clamp(min=1)


def main(folder: str, into: str, seconds: str = "240") -> None:
    """Trains for so long."""
    torch.manual_seed(1)
    torch.set_num_threads(1)
    begun = time.monotonic()
    frames = [(flattened(image), *targets(labels, image.shape)) for image, labels in samples(Path(folder), "train")]
    images, like, offsets, counts = (torch.stack([torch.as_tensor(frame[part]) for frame in frames]) for part in range(4))
    print(f"{len(images)} frames read in {time.monotonic() - begun:.0f} s", file=sys.stderr)
    network, chance = StarNetwork(), np.random.default_rng(1)
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    begun, step = time.process_time(), 0
    while (spent := (time.process_time() - begun) / float(seconds)) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = 3e-3 * 0.5 * (1 + np.cos(np.pi * spent))
        chosen = torch.from_numpy(chance.choice(len(images), BATCH, replace=False))
        top, left = chance.integers(0, images.shape[-1] - CROP_PX + 1, 2)
        part = np.s_[..., top : top + CROP_PX, left : left + CROP_PX]
        value = loss(network, *(all_[part][chosen] for all_ in (images, like, offsets, counts)))
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        step += 1
        if step % 50 == 0:
            print(f"{100 * spent:3.0f} %, step {step}: loss {value.item():.3f}", file=sys.stderr)
    network.eval()
    # The threshold is that of so many false stars on frames that the network has not seen.
    false, true, pixels = [], [], 0
    for image, labels in samples(Path(folder), "validation"):
        lights = labels["lights"]
        pixels += image.size
        places = np.column_stack([lights["x_px"], lights["y_px"]]).reshape(-1, 2)
        found = network.stars(image, -6.0)
        nearest = np.linalg.norm(found[:, None, :2] - places[None], axis=2) if len(places) and len(found) else np.full((len(found), 1), np.inf)
        false += list(found[nearest.min(axis=1) > 2.0, 2])
        for place in np.flatnonzero(lights["visible"]):
            own = found[nearest[:, place] < NEAR_PX] if len(found) else found
            true.append((lights["snr"][place], own[:, 2].max() if len(own) else -np.inf))
    allowed = max(1, round(FALSE_PER_MEGAPIXEL * pixels / 1e6))
    threshold = sorted(false)[-allowed] if len(false) >= allowed else -6.0
    torch.save({"network": network.state_dict(), "threshold": float(threshold)}, into)
    true = np.array(true)
    print(
        f"{step} steps of {BATCH} parts of frames, {CROP_PX} px wide, in {seconds} s of one processor; {sum(value.numel() for value in network.parameters())} numbers; threshold {threshold:.2f}"
    )
    for low, high in ((5, 10), (10, 20), (20, 1e9)):
        of = true[(true[:, 0] >= low) & (true[:, 0] < high), 1]
        print(f"stars of a signal-to-noise ratio from {low} to {high:g}: {(of >= threshold).mean():.1%} of {len(of)} found")


if __name__ == "__main__":
    main(*sys.argv[1:])
