"""One camera of a training: what it sees of a model, and what it should see. Letters: H rows, W columns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.images.composite import CompositeSource
from reconstruction.rendering.result import Instantaneous
from rigs.camera import Camera

MASKS = ("empty", "known", "focus")  # the masks of a view, float, 1 or 0


@dataclass(frozen=True, eq=False)
class TrainingView:
    """A camera and the images it should see.

    `corrected`: the cloud at an instant (s) as its refined pose, gain and lag show it (None: they stand as they are).
    `inverse_depth` [H, W]: of the pixels whose depth is known before the training, 1/m, else 0. `empty` [H, W]: 1 where
    nothing is, else 0; None where something is everywhere. `known` [H, W]: 1 where the images show what they should,
    else 0; None where they all do. `focus` [H, W]: 1 where most steps look, else 0; None where they look everywhere.
    `halvings`: how often pixels were merged, 2x2 each time, since the source's.
    `device`: where its pictures and masks lie, as the renders that they are compared with.
    """

    camera: Camera
    source: CompositeSource
    corrected: Callable[[DynamicCloud, float], Instantaneous] | None = None
    inverse_depth: Tensor | None = None
    empty: Tensor | None = None
    known: Tensor | None = None
    focus: Tensor | None = None
    halvings: int = 0
    device: str = "cpu"

    def on(self, device: str) -> TrainingView:
        """Return the same view with its pictures and masks on `device`; itself where they are there."""
        if device == self.device:
            return self
        held = ("inverse_depth", *MASKS)
        there = {name: None if (t := getattr(self, name)) is None else t.to(device) for name in held}
        return replace(self, device=device, **there)

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
        """The pixels [H, W], bool, that the camera saw whole and whose images are known; None where these are all."""
        way, known = self.source.straightening, self.known
        if way is not None:
            share = torch.from_numpy(way.covered).float().to(self.device)
            for _ in range(self.halvings):
                share = halved(share)
            known = share if known is None else known * share
        return None if known is None else known == 1

    @cached_property
    def compared(self) -> Tensor | None:
        """The pixels [H, W], bool, that a step compares: those `covered`, and in focus; None where these are all."""
        if self.focus is None:
            return self.covered
        focus = self.focus > 0
        return focus if self.covered is None else focus & self.covered

    @cached_property
    def whole(self) -> TrainingView:
        """The same view without a focus."""
        return self if self.focus is None else replace(self, focus=None)

    @cached_property
    def halved(self) -> TrainingView:
        """The same view at half the width and height: a quarter of the pixels, each the mean of four.

        A depth is known where those of all four are, and a pixel is empty where all four are.
        """
        known = self.inverse_depth
        if known is not None:
            known = torch.where(halved((known > 0).to(known.dtype)) == 1, halved(known), 0)
        flags = {}
        for name in MASKS:
            mask: Tensor | None = getattr(self, name)
            flags[name] = None if mask is None else (halved(mask) == 1).to(mask.dtype)
        camera, halvings = self.camera.halved(), self.halvings + 1
        return replace(self, camera=camera, inverse_depth=known, halvings=halvings, **flags)

    def dilation(self, usual_px2: float) -> float:
        """Return what its renders add to the covariance of a splat, px^2, where whole pictures add `usual_px2`.

        A merged pixel is the mean of n x n pixels, which spreads light by (n^2 - 1) / 12 of their squares more.
        """
        merged = 4**self.halvings
        return (usual_px2 + (merged - 1) / 12) / merged


def halved(image: Tensor) -> Tensor:
    """Return the mean [H // 2, W // 2] of each 2x2 pixels of an image [H, W]; an odd last row or column is left out."""
    height, width = (size // 2 for size in image.shape)
    above, below = image[: 2 * height : 2], image[1 : 2 * height : 2]
    rows = above + below
    return (rows[:, : 2 * width : 2] + rows[:, 1 : 2 * width : 2]) / 4
