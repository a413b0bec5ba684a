"""Reads a split by load_torch.py and writes what came, in a Python that has torch: torch_loader.py LOADERS DATASET SPLIT FILE.npz WORKERS…"""

import sys

import numpy as np
import torch

loaders, dataset, split, into, *workers = sys.argv[1:]
sys.path.insert(0, loaders)
from load_torch import Frames  # noqa: E402

read = {}
for count in workers:
    batches = list(torch.utils.data.DataLoader(Frames(dataset, split), batch_size=3, num_workers=int(count)))
    read |= {f"{name} {count}": torch.cat([batch[name] for batch in batches]).numpy() for name in ("key", "image", "distance")}
np.savez(into, **read)
print(torch.__version__)
