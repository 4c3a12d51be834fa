"""MSDI: rates of V views and their nominal rig to images, depth and residuals to that rig.

Images are those of the small Spk2ImgNet, trained further with the rest. The geometry sees them shrunk; poses are not
regressed but solved for from learnt correspondences (see `adjustment`), so that a network trained for an hour on a
processor can be held to what the nominal rig allows. Letters: V views, N tokens a view, h, w the views' size,
H, W the working size.
"""

import functools
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from reconstruction.networks.image_networks import evaluated, image_network
from reconstruction.networks.msdi.adjustment import SCHEDULE, Adjusted, Stage, adjust
from reconstruction.networks.msdi.depth import Sweep
from reconstruction.networks.msdi.encoder import Encoded, Encoder, Trunk
from reconstruction.networks.msdi.features import keypoints, patch_centers
from reconstruction.networks.msdi.matching import Matcher, Matches
from reconstruction.networks.msdi.views import GATE, Views, gate
from reconstruction.networks.spk2imgnet_small import SmallSpk2ImgNet
from reconstruction.tensors import read_weights

SHIPPED = Path(__file__).parent / "weights"
IMAGE_SHARE = 0.1  # share of the learning rate that the image network learns with
CLOSER_GATE = 0.035  # gate once the poses have been adjusted, as a share of the focal length
CLOSER = tuple(Stage(8, robust, 0.02, 0.02) for robust in (5.0, 2.0, 1.0, 0.5))


@dataclass(frozen=True, eq=False)
class Solved:
    """The rig found, the correspondences it rests on and the features they came from."""

    adjusted: Adjusted
    matches: Matches
    encoded: Encoded


class Msdi(nn.Module):
    """The image network `image`, the encoder around its trunk, the correlations and the sweep."""

    def __init__(self, trunk: nn.Module) -> None:
        super().__init__()
        self.image = SmallSpk2ImgNet()
        self.encoder = Encoder(trunk)
        self.matcher = Matcher()
        self.sweep = Sweep()

    def light(self, rates: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return light and sigma [V, 1, h, w] in spikes per tick, and their mean, of rates [V, BINS, h, w]."""
        level = image_network("small").level(rates)
        return *evaluated(self.image, rates, level), level

    def parameter_groups(self) -> list[dict]:
        """Return the optimiser's groups: the image network, which knows its task, learns at a share of the rate."""
        geometry = [p for part in (self.encoder, self.matcher, self.sweep) for p in part.parameters()]
        return [{"params": geometry}, {"params": list(self.image.parameters()), "share": IMAGE_SHARE}]

    def solve(self, seen: Tensor, nominal: Views, schedule: tuple[Stage, ...] = SCHEDULE) -> Solved:
        """Find poses from the channels `seen` [V, CHANNELS, H, W]: match inside the nominal gate, then adjust."""
        allowed = patch_gate(nominal, (seen.shape[3], seen.shape[2]))
        encoded = self.encoder(seen, allowed)
        matches = self.matcher(encoded, keypoints(seen), allowed)
        return Solved(adjust(nominal, matches, schedule), matches, encoded)

    def solve_again(self, first: Solved, size: tuple[int, int], nominal: Views) -> Solved:
        """Match once more inside a narrower gate around the poses found, and adjust from the nominal rig."""
        views = first.adjusted.views
        allowed = patch_gate(views, size, CLOSER_GATE)
        matches = self.matcher(first.encoded, first.matches.pixels, allowed)
        return Solved(adjust(nominal, matches, (*SCHEDULE[:3], *CLOSER)), matches, first.encoded)


def small_msdi() -> Msdi:
    """Build the small tier: 0.8 M parameters."""
    return Msdi(Trunk())


@functools.cache
def trained_msdi(weights: Path | None = None) -> Msdi:
    """Return the small tier with `weights`, by default those that ship; raises BadRunError where they do not fit."""
    module = small_msdi().eval()
    read_weights(weights or SHIPPED / "small.npz", module)
    return module


def patch_gate(views: Views, size: tuple[int, int], radius: float = GATE) -> Tensor:
    """Return which patches of views of `size` (W, H) may correspond [V, N, V, N]; see `gate`."""
    return gate(views.to(torch.float32), patch_centers(size).expand(len(views), -1, -1), radius)
