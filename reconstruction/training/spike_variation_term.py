"""Makes renders spike, and compares how their counts change over windows with the recorded ones: SPSS as we read it."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.losses.picture import misplaced_light
from reconstruction.losses.spiking import spike_variation_loss
from reconstruction.methods.definition import SpikeSampling
from reconstruction.training.draws import Draws
from reconstruction.training.image_term import ImageTerm, learnt_planes
from reconstruction.training.spike_term import part_with_mover
from reconstruction.training.view import TrainingView


@dataclass(frozen=True)
class SpikeVariationTerm:
    """Compares the changes of rendered light, made to spike, with those of the recorded spikes.

    Looks at `windows` windows of `planes` planes, `stride` planes from the begin of each to that of the next, in a part
    of the view in which something moves. The light over a window is that of its middle. Of a short clip windows are
    shorter.
    """

    image: ImageTerm
    sampling: SpikeSampling = field(default_factory=SpikeSampling)
    windows: int = 5
    planes: int = 16
    stride: int = 16

    def __call__(self, cloud: DynamicCloud, view: TrainingView, draws: Draws) -> Tensor:
        """Return the loss of one row of windows; of a clip of one plane, that of its image."""
        begin, end = learnt_planes(cloud, view)
        windows = min(self.windows, end - begin)
        if windows < 2:
            return self.image(cloud, view, draws)
        length, stride = self._fitting(end - begin, windows)
        part = part_with_mover(view, self.sampling.size_px, draws.rng)
        first = begin + draws.place(end - begin - (windows - 1) * stride - length + 1)
        starts = [first + i * stride for i in range(windows)]
        good = torch.from_numpy(~view.source.useless(starts[-1] + length)[part.within])
        renders = [self.image.over(cloud, view, part.camera, (start, length, 1)) for start in starts]
        charges = length * torch.stack([r.intensity[..., 0] for r in renders])[:, good]
        counted = [torch.from_numpy(part.counts(view, start, start + length)) for start in starts]
        gaps = (stride - length) / length * (charges[1:] + charges[:-1]) / 2
        spikes = spike_variation_loss(charges, torch.stack(counted)[:, good].to(charges.device), gaps)
        alpha = torch.stack([r.alpha for r in renders])
        return spikes / length + self.image.solid * misplaced_light(alpha, part.empty(view))

    def _fitting(self, planes: int, windows: int) -> tuple[int, int]:
        """Return the length and the stride of windows that a clip of so many planes has room for."""
        stride = max(1, min(self.stride, planes // windows))
        return max(1, min(self.planes, planes - (windows - 1) * stride)), stride
