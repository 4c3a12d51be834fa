"""The samples that MSDI learns from: some views of a clip, cropped and mirrored, with a nominal rig drawn anew.

Sample number n is the same whenever it is asked for. Letters: V views, H rows, W columns of the crop.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from acquisition.scenes.misplaced import misplaced
from reconstruction.errors import BadRunError
from reconstruction.networks.msdi.features import PATCH, channels
from reconstruction.networks.msdi.network import Msdi
from reconstruction.networks.msdi.views import Views, object_distance
from reconstruction.networks.rates import rates
from reconstruction.networks.training.clips import MultiviewClip, MultiviewClips, read_clip_set
from rigs.rig import Rig

THREE_VIEWS = 0.7  # share of the samples; the others have four, where the clips do
DISTANCES_M = (1.0, 3.0)  # the object's in any clip
MISJUDGED = (0.6, 1.6)  # least and largest distance by the nominal rig, as shares of the true one
FIRST_ERROR = 0.5  # degrees, cm and percent of the nominal rigs at the start of the training


@dataclass(frozen=True, eq=False)
class Sample:
    """Of V views: `maps` are channels [V, C, H, W], or where the image network learns (`raw`) rates [V, BINS, H, W].

    The true `light` [V, 1, H, W] and `depth` [V, H, W] in m, NaN where nothing is, and the true and nominal cameras.
    """

    raw: bool
    maps: Tensor
    light: Tensor
    depth: Tensor
    true: Views
    nominal: Views

    def to(self, device: torch.device) -> Sample:
        """Return the same on another device."""
        names = ("maps", "light", "depth", "true", "nominal")
        return replace(self, **{name: getattr(self, name).to(device) for name in names})


class Samples:
    """Samples of the clips in `folder`, seen through the image network `image_of` as it was at the start.

    Nominal rigs are off by up to `largest_error` degrees, cm and percent, rising over the first `rising` samples.
    """

    def __init__(self, folder: Path, network: Msdi, seed: int, largest_error: float, rising: int) -> None:
        self._folder, self._clips, self._network = folder, read_clip_set(folder, MultiviewClips), network
        self._seed, self._largest, self._rising = seed, largest_error, rising
        self.description = {"clips": asdict(self._clips)}  # for the document of the training
        self._kept: dict[int, tuple[NDArray, MultiviewClip]] = {}

    def sample(self, number: int, *, raw: bool) -> Sample:
        """Return sample `number`; with `raw`, rates for the image network to learn from."""
        rng = np.random.default_rng([self._seed, number])
        seed = int(rng.integers(self._clips.first_seed, self._clips.seeds.stop))
        count = min(self._clips.views, 3 if rng.random() < THREE_VIEWS else 4)
        which = [int(v) for v in rng.permutation(self._clips.views)[:count]]
        seen, clip = self._seen(seed)
        maps = np.stack([rates(clip.streams[v], clip.plane) for v in which]) if raw else seen[which].astype(np.float32)
        rig = clip.rig.only([clip.rig.ids[v] for v in which])
        reach = FIRST_ERROR + (self._largest - FIRST_ERROR) * min(1.0, number / max(1, self._rising))
        true = Views.of_rig(rig, distance=_distance(rig, *DISTANCES_M))
        drawn = misplaced(rig, rng.uniform(0, reach), int(rng.integers(2**31)))
        nominal = Views.of_rig(drawn, distance=_distance(drawn, *(true.distance * m for m in MISJUDGED)))
        cut = _Cut.drawn(rng, maps.shape[2], maps.shape[3])
        maps, light, depth = (torch.from_numpy(cut.of(a)) for a in (maps, clip.light[which], clip.depth[which]))
        return Sample(raw, maps, light[:, None], depth, cut.views(true), cut.views(nominal))

    def _seen(self, seed: int) -> tuple[NDArray, MultiviewClip]:
        if seed not in self._kept:
            clip = self._clips.read(self._folder, seed)
            observed = torch.from_numpy(np.stack([rates(stream, clip.plane) for stream in clip.streams]))
            with torch.no_grad():
                light, sigma, level = self._network.light(observed)
                seen = channels(light, sigma, observed, level, 1)
            self._kept[seed] = seen.numpy().astype(np.float16), clip
        return self._kept[seed]


def _distance(rig: Rig, least: float, most: float) -> float:
    """Return the object's distance by `rig`, kept within bounds; three cameras side by side hardly know it."""
    try:
        return min(max(object_distance(rig), least), most)
    except BadRunError:
        return most


@dataclass(frozen=True)
class _Cut:
    """A crop at (left, top), mirrored or not; patches come to lie elsewhere on the scene each time."""

    left: int
    top: int
    width: int
    height: int
    whole: int
    mirrored: bool

    @classmethod
    def drawn(cls, rng: np.random.Generator, height: int, width: int) -> _Cut:
        left, top = (int(v) for v in rng.integers(0, PATCH + 1, 2))
        cut_width, cut_height = ((side - PATCH) // PATCH * PATCH for side in (width, height))
        return cls(left, top, cut_width, cut_height, width, bool(rng.integers(2)))

    def of(self, array: NDArray) -> NDArray[np.float32]:
        turned = array[..., ::-1] if self.mirrored else array
        cut = turned[..., self.top : self.top + self.height, self.left : self.left + self.width]
        return np.ascontiguousarray(cut, dtype=np.float32)

    def views(self, views: Views) -> Views:
        rotation, center, principal = views.rotation, views.center, views.principal.clone()
        if self.mirrored:
            mirror = torch.diag(torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64))
            rotation, center = mirror @ rotation @ mirror, center @ mirror
            principal[:, 0] = self.whole - principal[:, 0]
        principal = principal - torch.tensor([self.left, self.top], dtype=torch.float64)
        return replace(views, rotation=rotation, center=center, principal=principal)
