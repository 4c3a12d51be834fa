"""Training of a network: resumable to the bit, with its error against time.

The folder holds `state.pt` (modules, optimiser, step), `training.json` (configuration, seeds, curve) and the averaged
weights as `NAME.npz`. Batches follow from the seed and the step alone, so a killed training goes on as if it had not
been. The weights that are scored and shipped are a running average: they are good before the rate has come down.
"""

import copy
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Generic, TypeVar

import torch
from torch import nn

from acquisition.bench_document import device
from acquisition.durable import write_json
from acquisition.progress import Progress, silent
from acquisition.revision import code_revision
from reconstruction.errors import BadRunError
from reconstruction.networks.training import processes
from reconstruction.tensors import read_tensors, write_tensors, write_weights

WARM_UP = 200  # steps
LAST_RATE = 0.02  # share of the learning rate at the last step
LARGEST_GRADIENT = 1.0

Network = TypeVar("Network", bound=nn.Module)
Score = Callable[[Network], dict[str, float]]
LossOf = Callable[[Network, int], torch.Tensor]


@dataclass(frozen=True)
class LoopConfig:
    """The name and length of a training; `averaged` is the share of the running average that a step keeps."""

    name: str
    steps: int
    learning_rate: float = 1e-3
    averaged: float = 0.998
    seed: int = 0
    score_every: int = 500

    def __post_init__(self) -> None:
        if self.steps < 1 or self.score_every < 1 or not self.learning_rate > 0 or not 0 <= self.averaged < 1:
            raise BadRunError(f"found the training {asdict(self)}", "1 step or more and a positive rate")

    def rate(self, step: int) -> float:
        """Return the learning rate of `step`: a short rise, then half a cosine."""
        left = (1 + math.cos(math.pi * min(1.0, step / self.steps))) / 2
        return self.learning_rate * min(1.0, (step + 1) / WARM_UP) * (LAST_RATE + (1 - LAST_RATE) * left)


class Loop(Generic[Network]):
    """A module on its way down the losses of numbered batches; `run` goes on from whatever `folder` holds.

    `loss_of(module, number)` is the loss of batch `number`. Raises BadRunError where the folder was begun with another
    configuration. More `steps` than before are a longer training, whose learning rate is that of the longer one from
    here on. `described` goes into the document. Of several processes (see `processes`) each takes its own batches.
    """

    def __init__(
        self, folder: Path, config: LoopConfig, module: Network, loss_of: LossOf[Network], device: str, described: dict
    ) -> None:
        self.config, self.folder, self.described = config, folder, described
        self.device, self.loss_of = torch.device(device), loss_of
        self.module = module.to(self.device)
        self.average = copy.deepcopy(self.module).requires_grad_(False)
        groups = getattr(module, "parameter_groups", lambda: [{"params": list(module.parameters())}])()
        self.optimiser = torch.optim.Adam(groups, config.learning_rate)
        self.step, self.seconds, self.recent = 0, 0.0, 0.0
        self.curve: list[dict[str, float]] = []
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / "state.pt").exists():
            self._resume(read_tensors(folder / "state.pt", "one of this version", "start afresh"))

    def run(self, score: Score[Network], progress: Progress = silent) -> None:
        """Train up to the last step; take the averaged network's `score` and store all every `score_every` steps."""
        while self.step < self.config.steps:
            began = time.monotonic()
            self._take_step()
            self.seconds += time.monotonic() - began
            if self.step % self.config.score_every == 0 or self.step == self.config.steps:
                if processes.first():
                    found = score(copy.deepcopy(self.average).cpu().eval())
                    self.curve.append({"step": self.step, "seconds": self.seconds, "loss": self.recent} | found)
                    self._store()
                processes.wait()
            progress(self.step / self.config.steps, f"step {self.step}, loss {self.recent:.4f}")

    def _take_step(self) -> None:
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.rate(self.step) * group.get("share", 1.0)
        found = self.loss_of(self.module, processes.own(self.step))
        self.optimiser.zero_grad()
        found.backward()
        processes.average_gradients(self.module.parameters())
        norm = nn.utils.clip_grad_norm_(self.module.parameters(), LARGEST_GRADIENT)
        sound = bool(torch.isfinite(norm)) and bool(torch.isfinite(found))
        if sound:  # a step that would spoil the weights is left out
            self.optimiser.step()
        self.step += 1
        keep = min(self.config.averaged, self.step / (self.step + 10))
        with torch.no_grad():
            for mean, now in zip(self.average.parameters(), self.module.parameters(), strict=True):
                mean.lerp_(now, 1 - keep)
        self.recent += (found.item() - self.recent) * max(0.01, 1 / self.step) if sound else 0.0

    def _store(self) -> None:
        state = {
            "config": asdict(self.config),
            "module": self.module.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "progress": {"step": self.step, "seconds": self.seconds, "recent": self.recent},
            "curve": self.curve,
        }
        write_tensors(self.folder / "state.pt", state)
        write_weights(self.folder / f"{self.config.name}.npz", self.average.state_dict())
        write_json(self.folder / "training.json", self._document())

    def _resume(self, state: dict) -> None:
        found, expected = dict(state["config"]), asdict(self.config)
        for changeable in ("steps", "score_every"):
            found.pop(changeable)
            expected.pop(changeable)
        if found != expected:
            raise BadRunError(f"found a training of {found}", f"{expected}", "give a new folder", where=self.folder)
        self.module.load_state_dict(state["module"])
        self.average.load_state_dict(state["average"])
        self.optimiser.load_state_dict(state["optimiser"])
        self.step, self.seconds, self.recent = (state["progress"][name] for name in ("step", "seconds", "recent"))
        self.curve = list(state["curve"])

    def _document(self) -> dict:
        accelerator = None if self.device.type == "cpu" else str(self.device)
        return {
            "network": self.config.name,
            "parameters": sum(p.numel() for p in self.module.parameters()),
            "config": asdict(self.config),
            "device": device() | {"threads": torch.get_num_threads(), "accelerator": accelerator},
            "revision": code_revision(),
            **self.described,
            "curve": self.curve,
        }
