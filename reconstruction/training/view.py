"""One camera of a training: what it sees of a model, and what it should see. Letters: H rows, W columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.images.composite import CompositeSource
from reconstruction.rendering.result import GUARDS, Instantaneous
from rigs.camera import Camera


@dataclass(frozen=True, eq=False)
class TrainingView:
    """A camera and the images it should see.

    `corrected`: the cloud at an instant (s) as its refined pose, gain and lag show it (None: they stand as they are).
    `inverse_depth` [H, W]: of the pixels whose depth is known before the training, 1/m, else 0. `empty` [H, W]: 1 where
    nothing is, else 0; None where something is everywhere. `halvings`: how often pixels were merged, 2x2 each time,
    since the source's. `device`: where its pictures and masks lie, as the renders that they are compared with.
    """

    camera: Camera
    source: CompositeSource
    corrected: Callable[[DynamicCloud, float], Instantaneous] | None = None
    inverse_depth: Tensor | None = None
    empty: Tensor | None = None
    halvings: int = 0
    device: str = "cpu"

    def on(self, device: str) -> TrainingView:
        """Return the same view with its pictures and masks on `device`; itself where they are there."""
        if device == self.device:
            return self
        known, empty = (None if t is None else t.to(device) for t in (self.inverse_depth, self.empty))
        return replace(self, device=device, inverse_depth=known, empty=empty)

    def seen(self, cloud: DynamicCloud, instant_s: float) -> Instantaneous:
        """Return the Gaussians to render for this camera at an instant (s, rig clock)."""
        return self.corrected(cloud, instant_s) if self.corrected else cloud.at(instant_s)

    def picture(self, plane: int) -> Tensor:
        """Return the image [H, W] that it should see at `plane`, spikes per tick."""
        image = torch.from_numpy(self.source.at(plane)).to(self.device)
        for _ in range(self.halvings):
            image = halved(image)
        return image

    @cached_property
    def covered(self) -> Tensor | None:
        """The pixels [H, W], bool, that the camera saw whole; None where it saw all."""
        way = self.source.straightening
        if way is None:
            return None
        share = torch.from_numpy(way.covered).float().to(self.device)
        for _ in range(self.halvings):
            share = halved(share)
        return share == 1

    @cached_property
    def halved(self) -> TrainingView:
        """The same view at half the width and height: a quarter of the pixels, each the mean of four.

        A depth is known where those of all four are, and a pixel is empty where all four are.
        """
        known, empty = self.inverse_depth, self.empty
        if known is not None:
            known = torch.where(halved((known > 0).to(known.dtype)) == 1, halved(known), 0)
        if empty is not None:
            empty = (halved(empty) == 1).to(empty.dtype)
        camera, halvings = self.camera.halved(), self.halvings + 1
        return replace(self, camera=camera, inverse_depth=known, empty=empty, halvings=halvings)

    @property
    def dilation_px2(self) -> float:
        """The variance, px^2, that its renders add to splats: as much light is spread as over the source's pixels.

        A mean of n x n pixels, of n^2 of which it is one, has the variance (n^2 - 1) / 12 of their squares.
        """
        merged = 4**self.halvings
        return (GUARDS.dilation_px2 + (merged - 1) / 12) / merged


def halved(image: Tensor) -> Tensor:
    """Return the mean [H // 2, W // 2] of each 2x2 pixels of an image [H, W]; an odd last row or column is left out."""
    height, width = (size // 2 for size in image.shape)
    above, below = image[: 2 * height : 2], image[1 : 2 * height : 2]
    rows = above + below
    return (rows[:, : 2 * width : 2] + rows[:, 1 : 2 * width : 2]) / 4
