"""Random crops to train on, turned, mirrored and run backwards; batch number n is the same whenever it is asked for."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.networks.image_networks import ImageNetwork, image_network, loss
from reconstruction.networks.training.clips import CameraClips, read_clip_set
from reconstruction.networks.training.loop import Loop, LoopConfig

POOL = 64  # (stream, instant) pairs of a recording that are kept in memory


class ClipPictures:
    """The instants of the clips in `folder`, kept in memory once seen.

    `smallest` is their shorter side in pixels; `description` says what they are in the document of the training.
    """

    def __init__(self, folder: Path, network: ImageNetwork) -> None:
        self._clips = read_clip_set(folder, CameraClips)
        self._folder, self._network = folder, network
        self.smallest, self.description = self._clips.size, {"clips": asdict(self._clips)}
        self._kept: dict[int, tuple[list[NDArray], NDArray]] = {}

    def draw(self, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
        """Draw one instant of one clip: the input [C, H, W] and the true light [1, H, W]."""
        seed = int(rng.integers(self._clips.first_seed, self._clips.seeds.stop))
        if seed not in self._kept:
            clip = self._clips.read(self._folder, seed)
            self._kept[seed] = [_halved(self._network, clip.stream, k) for k in clip.instants], clip.truth
        inputs, truth = self._kept[seed]
        instant = int(rng.integers(len(inputs)))
        return inputs[instant], truth[instant, None]


class StreamPictures:
    """`POOL` instants of some streams, drawn once from `seed`; nobody knows their true light. See `ClipPictures`."""

    def __init__(self, streams: Sequence[SpikeStream], network: ImageNetwork, seed: int) -> None:
        if not streams or not min(len(stream) for stream in streams):
            raise BadRunError("found no planes to train on", "a recording with some")
        rng = np.random.default_rng([seed, 0xB1])
        self.smallest = min(min(stream.layout.width, stream.layout.height) for stream in streams)
        drawn = [(int(rng.integers(len(streams))), rng.random()) for _ in range(POOL)]
        at = [(camera, int(share * len(streams[camera]))) for camera, share in drawn]
        self._inputs = [_halved(network, streams[camera], plane) for camera, plane in at]
        self.description = {"instants": [list(place) for place in at]}

    def draw(self, rng: np.random.Generator) -> tuple[NDArray, None]:
        """Draw one of the pool: the input [C, H, W]."""
        return self._inputs[int(rng.integers(POOL))], None


Pictures = ClipPictures | StreamPictures


class Batches:
    """Batches of `batch` crops of `crop` x `crop` pixels of some pictures."""

    def __init__(self, pictures: Pictures, network: ImageNetwork, batch: int, crop: int, seed: int) -> None:
        if not 1 <= crop <= pictures.smallest or batch < 1:
            raise BadRunError(f"found batches of {batch} crops of {crop} px", f"crops up to {pictures.smallest} px")
        self.pictures = pictures
        self._reverse = network.reverse
        self._batch, self._crop, self._seed = batch, crop, seed

    def batch(self, number: int) -> tuple[Tensor, Tensor | None]:
        """Return what the network sees [N, C, h, w] and the true light [N, 1, h, w], where known, of batch `number`."""
        rng = np.random.default_rng([self._seed, number])
        pairs = [self._sample(rng) for _ in range(self._batch)]
        seen = torch.from_numpy(np.stack([seen for seen, _ in pairs]).astype(np.float32))
        lights = [light for _, light in pairs if light is not None]
        return seen, torch.from_numpy(np.stack(lights).astype(np.float32)) if len(lights) == len(pairs) else None

    def _sample(self, rng: np.random.Generator) -> tuple[NDArray, NDArray | None]:
        seen, light = self.pictures.draw(rng)
        row, column = (int(rng.integers(0, side - self._crop + 1)) for side in seen.shape[1:])
        mirrored, quarters = (bool(rng.integers(2)), bool(rng.integers(2))), int(rng.integers(4))

        def turned(array: NDArray) -> NDArray:
            cut = array[:, row : row + self._crop, column : column + self._crop]
            return np.rot90(cut[..., ::-1] if mirrored[1] else cut, quarters, axes=(1, 2))

        return turned(self._reverse(seen) if mirrored[0] else seen), None if light is None else turned(light)


def _halved(network: ImageNetwork, stream: SpikeStream, plane: int) -> NDArray:
    seen = network.observe(stream, plane)
    return seen.astype(np.float16) if seen.dtype == np.float32 else seen  # 3e-4 of a rate at most


@dataclass(frozen=True)
class ImageTrainingConfig(LoopConfig):
    """A loop over batches of `batch` crops of `crop` px a side."""

    batch: int = 8
    crop: int = 64


class ImageTraining(Loop[nn.Module]):
    """One image network on batches of `pictures`; see `Loop`. `notes` go into the document."""

    def __init__(
        self, folder: Path, config: ImageTrainingConfig, pictures: Pictures, device: str = "cpu", **notes: object
    ) -> None:
        self.network = image_network(config.name)
        self.batches = Batches(pictures, self.network, config.batch, config.crop, config.seed)
        torch.manual_seed(config.seed)
        described = {"pictures": pictures.description, **notes}
        super().__init__(folder, config, self.network.build(), self._loss_of, device, described)

    def _loss_of(self, module: nn.Module, number: int) -> torch.Tensor:
        seen, truth = self.batches.batch(number)
        seen = seen.to(self.device, memory_format=torch.channels_last)
        return loss(self.network, module, seen, None if truth is None else truth.to(self.device))
