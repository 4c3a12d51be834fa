"""LPIPS with AlexNet: the distance of two images in the features of a network whose weights the user brings.

Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric", CVPR 2018. The weights of the
layers come with torchmetrics; the network's are torchvision's `alexnet*.pth`, which the user brings. Nothing is
downloaded, and both files are read as tensors only.
"""

import pickle
import zipfile
from importlib.resources import files
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from reconstruction.errors import BadRunError

_LAYERS = ((0, 4, 2), (3, 1, 2), (6, 1, 1), (8, 1, 1), (10, 1, 1))  # number, stride, padding of the convolutions
_POOLED = (3, 6)
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)


class Lpips:
    """Distance of display images [H, W] in 0 to 1, at least 63 pixels a side; 0 for equal ones.

    Raises BadRunError where `weights` does not hold AlexNet's features.
    """

    def __init__(self, weights: Path):
        try:
            network = torch.load(weights, map_location="cpu", weights_only=True)
            self._layers = [(network[f"features.{n}.weight"], network[f"features.{n}.bias"]) for n, _, _ in _LAYERS]
        except (OSError, KeyError, TypeError, RuntimeError, EOFError, pickle.UnpicklingError, zipfile.BadZipFile) as e:
            reason = str(e).partition("\n")[0]
            raise BadRunError(f"found no weights of AlexNet ({reason})", "torchvision's", where=weights) from e
        with files("torchmetrics").joinpath("functional/image/lpips_models/alex.pth").open("rb") as heads:
            stored = torch.load(heads, map_location="cpu", weights_only=True)
        self._heads = [stored[f"lin{i}.model.1.weight"] for i in range(len(_LAYERS))]

    @torch.no_grad()
    def __call__(self, image: NDArray[np.float32], truth: NDArray[np.float32]) -> float:
        """Return the distance of two display images [H, W] in 0 to 1."""
        total = 0.0
        for a, b, head in zip(self._features(image), self._features(truth), self._heads, strict=True):
            total += float(functional.conv2d((_unit(a) - _unit(b)) ** 2, head).mean())
        return total

    def _features(self, image: NDArray[np.float32]) -> list[Tensor]:
        grey = torch.from_numpy(np.clip(image, 0, 1).astype(np.float32))[None, None].expand(-1, 3, -1, -1) * 2 - 1
        x = (grey - torch.tensor(_SHIFT).view(1, 3, 1, 1)) / torch.tensor(_SCALE).view(1, 3, 1, 1)
        found = []
        for (number, stride, padding), (weight, bias) in zip(_LAYERS, self._layers, strict=True):
            if number in _POOLED:
                x = functional.max_pool2d(x, 3, 2)
            x = functional.relu(functional.conv2d(x, weight, bias, stride, padding))
            found.append(x)
        return found


def _unit(x: Tensor) -> Tensor:
    return x / (x.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)
