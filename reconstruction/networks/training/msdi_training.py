"""The training of MSDI: one sample a step, jointly or with image and geometry apart.

A `pretrained` image network starts from the weights of the small Spk2ImgNet. The geometry sees images by those first
weights. From step `image_from` on, every `IMAGE_EVERY`th step shows it images by the network as it is now. Then the
geometry also teaches the image network if the training is `joint`, and does not otherwise (the paper's ablation). An
image network that is not pretrained learns from the first step, and the geometry sees its images alone.
"""

import json
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

from reconstruction.errors import BadRunError
from reconstruction.networks.image_networks import SHIPPED, light_loss
from reconstruction.networks.msdi.features import channels, keypoints
from reconstruction.networks.msdi.large import large_msdi
from reconstruction.networks.msdi.network import Msdi, patch_gate, small_msdi
from reconstruction.networks.training import processes
from reconstruction.networks.training.loop import Loop, LoopConfig
from reconstruction.networks.training.msdi_losses import correspondences, depth_loss, fine_loss, pose_loss, token_loss
from reconstruction.networks.training.msdi_samples import Sample, Samples
from reconstruction.tensors import read_weights

TIERS = ("small", "large")
IMAGE_EVERY, POSE_EVERY, DEPTH_EVERY = 4, 4, 3  # steps
POSE_WEIGHT, IMAGE_WEIGHT, DEPTH_WEIGHT = 0.1, 1.0, 1.0


@dataclass(frozen=True)
class MsdiConfig(LoopConfig):
    """A loop over samples; images learn from step `image_from` on, poses are judged from `pose_from` on.

    Nominal rigs are off by up to `largest_error` degrees, cm and percent, less before `pose_from`.
    """

    joint: bool = True
    pretrained: bool = True
    image_from: int = 1500
    pose_from: int = 600
    largest_error: float = 3.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.largest_error <= 0 or min(self.image_from, self.pose_from) < 0:
            raise BadRunError(f"found {self}", "an error above 0 and steps from 0")


class MsdiTraining(Loop[Msdi]):
    """MSDI on its way; see `Loop`. The clips are in `clips`; `config.name` is the tier, `backbone` the large one's.

    It begins with the weights beside the document `after` of an earlier training, if there is one, and tells in its
    own document what those have learnt. Raises BadRunError for an unknown tier, or a backbone for the small one.
    """

    def __init__(
        self,
        folder: Path,
        config: MsdiConfig,
        clips: Path,
        device: str,
        notes: dict,
        *,
        backbone: Path | None = None,
        after: Path | None = None,
    ) -> None:
        torch.manual_seed(config.seed)
        network, first = _tier(config.name, backbone), small_msdi()
        for module in (network, first) if config.pretrained else (first,):
            read_weights(SHIPPED / "small.npz", module.image)
        if after:
            read_weights(after.parent / f"{config.name}.npz", network)
        self.wanted = config
        self.samples = Samples(clips, first.eval(), config.seed, config.largest_error, config.pose_from)
        described = {"pictures": self.samples.description, **notes, "after": _history(after) if after else []}
        super().__init__(folder, config, network, self._loss_of, device, described)

    def _loss_of(self, module: Msdi, number: int) -> Tensor:
        step = processes.step_of(number)  # all processes judge the same, so that none waits for another
        raw = (step >= self.wanted.image_from and step % IMAGE_EVERY == 1) or not self.wanted.pretrained
        pose = step >= self.wanted.pose_from and step % POSE_EVERY == 3
        sample = self.samples.sample(number, raw=raw).to(self.device)
        with self.device:  # where what is made on the way lies
            depth = step % DEPTH_EVERY == 0
            return sample_loss(module, sample, number, joint=self.wanted.joint, pose=pose, depth=depth)


def _history(document: Path) -> list[dict]:
    """Return the documents of the trainings that led to this one's, the oldest first and this one last."""
    try:
        known = json.loads(document.read_text())
        return [*known.pop("after", []), known]
    except (OSError, ValueError, TypeError, AttributeError) as error:
        expected = "the document of a training, beside its weights"
        raise BadRunError("found none that can be read", expected, where=document) from error


def _tier(name: str, backbone: Path | None) -> Msdi:
    if name not in TIERS or (backbone and name != "large"):
        raise BadRunError(f"found the tier {name!r} with the backbone {backbone}", "small, or large with or without")
    return large_msdi(backbone=backbone) if name == "large" else small_msdi()


def sample_loss(network: Msdi, sample: Sample, number: int, *, joint: bool, pose: bool, depth: bool) -> Tensor:
    """Return the losses of one sample, those of `pose` and `depth` where wanted; `number` seeds what is drawn."""
    image, seen = _seen(network, sample, joint)
    pixels = keypoints(seen.detach())
    allowed = patch_gate(sample.nominal, (seen.shape[3], seen.shape[2]))
    encoded = network.encoder(seen, allowed)
    truth = correspondences(sample.depth, sample.true, pixels)
    total = image + token_loss(network.matcher.token_logs(encoded.tokens, allowed), truth[1], allowed)
    total = total + fine_loss(network.matcher, encoded, pixels, truth, number)
    if depth:
        view = number % len(seen)  # any: a sample has its views in an order of its own
        swept = network.sweep(encoded.middle, sample.true, view)
        total = total + DEPTH_WEIGHT * depth_loss(swept, sample.depth[view], sample.true)
    if pose:
        total = total + POSE_WEIGHT * pose_loss(sample.nominal, sample.true, network.matcher(encoded, pixels, allowed))
    return total


def _seen(network: Msdi, sample: Sample, joint: bool) -> tuple[Tensor, Tensor]:
    """Return the loss of the images, where they learn, and the channels that the geometry sees."""
    if not sample.raw:
        return sample.maps.new_zeros(()), sample.maps
    light, sigma, level = network.light(sample.maps)
    found = light_loss(light, sigma, sample.light, level)
    if not joint:
        light, sigma = light.detach(), sigma.detach()
    return IMAGE_WEIGHT * found, channels(light, sigma, sample.maps, level, 1)
