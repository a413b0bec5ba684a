"""A small network that finds stars: of each pixel how like the pixel of a star's centre it is, and where in it the centre lies."""

import numpy as np
import torch
from torch import nn
from torch.nn.functional import interpolate, max_pool2d

BLOCK = 16  # px: the sky is the median of such squares


def flattened(image: np.ndarray) -> torch.Tensor:
    """An image of any camera as a network sees it: counts above the sky in units of the noise, by the arcsine-hyperbolic. `image`: rows and columns, DN."""
    image = image.astype(np.float32)
    height, width = image.shape
    padded = np.pad(image, ((0, -height % BLOCK), (0, -width % BLOCK)), mode="edge")
    rows, columns = padded.shape[0] // BLOCK, padded.shape[1] // BLOCK
    levels = np.median(padded.reshape(rows, BLOCK, columns, BLOCK), axis=(1, 3))
    sky = interpolate(torch.from_numpy(levels)[None, None], scale_factor=BLOCK, mode="bilinear", align_corners=False)[0, 0].numpy()
    above = image - sky[:height, :width]
    # Of differences between neighbours, so that what is left of the sky does not count; whole counts hide less noise than a third of their step.
    steps = np.diff(np.unique(image))
    noise = 1.4826 * np.median(np.abs(np.diff(image, axis=1))) / 2**0.5
    noise = max(noise, 0.3 * float(steps.min()) if len(steps) else 1.0)
    return torch.from_numpy(np.arcsinh(above / noise))[None]


class StarNetwork(nn.Module):
    """Six convolutions that keep the size: 5391 numbers, which see 15 pixels across."""

    def __init__(self, width: int = 12):
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(1, width, 3, padding=1), nn.ReLU()]
        for dilation in (1, 2, 2, 1):
            layers += [nn.Conv2d(width, width, 3, padding=dilation, dilation=dilation), nn.ReLU()]
        self.body = nn.Sequential(*layers)
        self.head = nn.Conv2d(width, 3, 1)
        nn.init.constant_(self.head.bias, 0.0)
        with torch.no_grad():
            self.head.bias[0] = -5.0  # few pixels have a star

    def forward(self, images: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Images (N, 1, H, W): logits (N, H, W), and offsets of the centre from the middle of the pixel (N, 2, H, W), x first."""
        out = self.head(self.body(images))
        return out[:, 0], 0.75 * torch.tanh(out[:, 1:])

    def stars(self, image: np.ndarray, threshold: float) -> np.ndarray:
        """Stars of one image (rows and columns, DN): an array (N, 3) of x, y (px, from the centre of the first pixel) and logit, above the threshold."""
        with torch.no_grad():
            logits, offsets = self(flattened(image)[None])
        logits, offsets = logits[0], offsets[0]
        peaks = (logits == max_pool2d(logits[None, None], 3, stride=1, padding=1)[0, 0]) & (logits > threshold)
        y, x = torch.nonzero(peaks, as_tuple=True)
        found = torch.stack([x + offsets[0, y, x], y + offsets[1, y, x], logits[y, x]], dim=1)
        return found.numpy()
