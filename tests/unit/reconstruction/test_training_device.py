"""Training on another device: nothing on it meets anything beside it, and what is written is on the CPU.

No GPU is needed. Tensors on torch's device `meta`, which have no numbers, stand for those on a GPU, and a renderer of
as little content for gsplat's. Beside that, torch's twins of the kernels train on the CPU as a GPU would.
"""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from acquisition.progress import silent
from reconstruction.errors import BadRunError
from reconstruction.gaussians import course, riding
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.losses import picture
from reconstruction.methods.definition import SpikeSampling, Training
from reconstruction.pipeline.stages import reconstruct
from reconstruction.pipeline.watch import Watch
from reconstruction.rendering import gsplat_backend
from reconstruction.run.configuration import CUDA, SUPERVISIONS, ReconstructionConfig
from reconstruction.tensors import on_cpu, write_tensors
from reconstruction.training import optimizer
from reconstruction.training.adam import Adam
from reconstruction.training.changed_pixels import unsettled
from reconstruction.training.checkpoint import load_checkpoint
from reconstruction.training.trainer import Trainer, TrainerSettings
from reconstruction.training.view import TrainingView
from server.work.wording import in_request_words
from tests.unit.reconstruction.test_gsplat_backend import as_gsplat
from tests.unit.reconstruction.test_motion_training import CAMERA, CLOCK, HEIGHT, KINDS, WIDTH, cloud, recorded_view

MISSING = gsplat_backend.why_unavailable()
ELSEWHERE = "meta"
TAKEN = list(SUPERVISIONS)
CROSSING = (Tensor.to, Tensor.copy_, Tensor.__getitem__, Tensor.__setitem__)  # may name tensors of two devices


class Elsewhere(TorchFunctionMode):
    """Makes `meta` as strict as a GPU: no call may mix it with the CPU. Where a number is asked for, it is 0.5."""

    timestep = 0  # the one number that a model counts and reads again

    def __torch_function__(self, func, types, args=(), kwargs=None):
        tensors = [x for x in flat((args, kwargs or {})) if isinstance(x, Tensor)]
        first = tensors[0] if tensors else None
        if first is not None and first.is_meta:
            if func in (Tensor.item, Tensor.__float__):
                return 0.5
            if func is Tensor.__bool__:
                return True
            if func is Tensor.__int__:
                return self.timestep
            if func is Tensor.add_ and first.dtype == torch.int64:
                self.timestep += 1
            if func is Tensor.cpu:
                return torch.full(first.shape, 0.5).to(first.dtype)
        elif func is Tensor.to and first is not None and first.requires_grad and ELSEWHERE in map(str, args[1:]):
            return Crossing.apply(first)
        places = {x.device.type for x in tensors if x.ndim}
        if func not in CROSSING and len(places) > 1:
            raise AssertionError(f"{func} of tensors on {' and '.join(sorted(places))}")
        return func(*args, **(kwargs or {}))


class Crossing(torch.autograd.Function):
    """A tensor taken to `meta`, whose gradient comes back as zeros: `meta` has none to give."""

    @staticmethod
    def forward(ctx, tensor):
        return tensor.to(ELSEWHERE)

    @staticmethod
    def backward(ctx, gradient):
        return torch.zeros(gradient.shape)


def flat(values):
    for value in values.values() if isinstance(values, dict) else values:
        if isinstance(value, (dict, list, tuple)):
            yield from flat(value)
        else:
            yield value


def without_content(means, quats, scales, opacities, colors, viewmats, Ks, width, height, **options):
    """Something of the right shapes that every tensor has a part in."""
    light = means.sum() + quats.sum() + scales.sum() + opacities.sum() + colors.sum() + viewmats.sum() + Ks.sum()
    nothing = means.new_zeros(1, height, width, 1)
    radii = torch.zeros(1, len(means), 2, dtype=torch.int32, device=means.device)
    return nothing.expand(-1, -1, -1, colors.shape[1] + 1) + light, nothing + light, {"radii": radii}


@pytest.fixture
def elsewhere(monkeypatch):
    monkeypatch.setattr(gsplat_backend, "_rasterization", lambda: without_content)
    monkeypatch.setattr(gsplat_backend, "DEVICE", ELSEWHERE)
    with Elsewhere() as mode:
        yield mode


@pytest.fixture(scope="module")
def view() -> TrainingView:
    """A view of which some pixels are empty and some depths known."""
    left = torch.zeros(HEIGHT, WIDTH)
    left[:, : WIDTH // 2] = 1
    return replace(recorded_view(), inverse_depth=left / 2, empty=1 - left)


def trainer_of(kind: str, view: TrainingView, supervision: str, device: str, **more) -> Trainer:
    training = Training(
        canonical_until=0.3, holds_depth=0.1, deblurs=True, spikes=SpikeSampling(2, (8, 33), size_px=(20, 16))
    )
    settings = TrainerSettings(supervision, training, image_planes=9, backend="gsplat", device=device, **more)
    return Trainer(cloud(kind), [view, view], settings, CLOCK, seed=1)


def losses(trainer: Trainer) -> list[float]:
    return [trainer.step(step / 6) for step in range(6)]


def places(trainer: Trainer) -> set[str]:
    moments = [state[key] for state in trainer.optimizer.state.values() for key in ("exp_avg", "exp_avg_sq")]
    masks = [t for v in trainer.views for t in (v.inverse_depth, v.empty, v.picture(0))]
    return {t.device.type for t in (*(t for _, t in trainer.cloud.tensors()), *moments, *masks)}


@pytest.mark.parametrize(
    ("kind", "supervision", "more"),
    [
        *((kind, "pixels", {"doublings": (0.6,)}) for kind in KINDS),
        *(("polynomial", name, {}) for name in TAKEN if name != "pixels"),
        ("bases", "both", {"refines": True}),
        ("polynomial", "pixels", {"times": True, "ends_early": True}),
    ],
)
def test_nothing_of_a_training_is_left_beside_the_device(kind, supervision, more, view, elsewhere, tmp_path):
    trainer = trainer_of(kind, view, supervision, ELSEWHERE, **more)
    for step in range(8):
        trainer.step(step / 8)
    assert places(trainer) == {ELSEWHERE}
    assert not isinstance(trainer.optimizer, Adam)
    write_tensors(tmp_path / "state.pt", trainer.state())
    resumed = trainer_of(kind, view, supervision, ELSEWHERE, **more)
    resumed.restore(load_checkpoint(tmp_path / "state.pt"))
    resumed.step(1.0)
    assert places(resumed) == {ELSEWHERE}
    assert resumed.steps == 9


def test_still_gaussians_are_let_go_on_the_device(view, elsewhere):
    trainer = trainer_of("polynomial", view, "pixels", ELSEWHERE)
    trainer.step(0.2)
    trainer.unsettle([view, view], torch.arange(len(trainer.cloud.still)) < 7)
    trainer.step(0.3)
    assert len(trainer.cloud.moving) == 9
    assert places(trainer) == {ELSEWHERE}


def test_pixels_that_a_lens_did_not_cover_are_known_on_the_device(view, elsewhere):
    covered = np.ones((HEIGHT, WIDTH), np.float32)
    covered[:3] = 0.4
    noise = np.full((HEIGHT, WIDTH), 0.9, np.float32)
    way = SimpleNamespace(covered=covered, noise=noise)
    bent = replace(view, source=replace(view.source, straightening=way))
    trainer = trainer_of("polynomial", bent, "counts", ELSEWHERE)
    for step in range(4):
        trainer.step(step / 4)
    assert trainer.views[0].covered.device.type == ELSEWHERE


def test_the_watch_takes_pixels_out_of_the_known_depths_on_the_device(view, elsewhere):
    trainer = trainer_of("polynomial", view, "pixels", ELSEWHERE)
    moving = np.ones((HEIGHT, WIDTH), bool)
    watch = Watch(SimpleNamespace(plan=SimpleNamespace(images="tfp")), trainer)
    trainer.unsettle(watch._retargeted({0: moving}), unsettled(trainer.cloud.still.means, [CAMERA], {0: moving}))
    trainer.step(0.3)
    assert places(trainer) == {ELSEWHERE}


def test_the_stand_in_finds_a_tensor_that_was_left_behind(elsewhere):
    there = torch.zeros(3, 3, device=ELSEWHERE)
    with pytest.raises(AssertionError, match="cpu and meta"):
        there @ torch.zeros(3, 3)


SHAKEN_M = 0.01


def uneven(kind: str) -> DynamicCloud:
    """A cloud of no spheres on no grid: symmetry leaves gradients of rounding alone, of which Adam takes the sign."""
    found, generator = cloud(kind), torch.Generator().manual_seed(0)
    for part in (found.still, found.moving):
        part.log_scales += torch.tensor([0.4, 0.0, -0.4])
        part.means += SHAKEN_M * torch.randn(part.means.shape, generator=generator)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_torch_trains_as_the_kernels_do(kind, view, monkeypatch):
    """The same steps by torch's twins, with the reference behind gsplat's signature, and by the kernels."""
    training = Training(canonical_until=0.3, holds_depth=0.1)
    settings = TrainerSettings("counts", training, doublings=(0.4,))
    expected = losses(Trainer(uneven(kind), [view], settings, CLOCK, seed=1))
    monkeypatch.setattr(gsplat_backend, "_rasterization", lambda: as_gsplat)
    monkeypatch.setattr(gsplat_backend, "DEVICE", "cpu")
    for module in (course, riding, picture, optimizer):
        monkeypatch.setattr(module, "fits", lambda *tensors: False)
    other = Trainer(uneven(kind), [view], replace(settings, backend="gsplat"), CLOCK, seed=1)
    assert not isinstance(other.optimizer, Adam)
    found = losses(other)
    assert found[0] == pytest.approx(expected[0], rel=1e-4)
    np.testing.assert_allclose(found, expected, rtol=1e-3)  # worst so far 3e-5


@pytest.mark.gpu
@pytest.mark.skipif(MISSING is not None, reason=str(MISSING))
@pytest.mark.parametrize("kind", KINDS)
def test_a_gpu_trains_as_the_kernels_do_and_resumes(kind, view, tmp_path):
    settings = TrainerSettings("counts", Training(canonical_until=0.3, holds_depth=0.1), doublings=(0.4,))
    expected = losses(Trainer(cloud(kind), [view], settings, CLOCK, seed=1))
    there = replace(settings, backend="gsplat", device="cuda")
    trainer, resumed = (Trainer(cloud(kind), [view], there, CLOCK, seed=1) for _ in range(2))
    found = losses(trainer)
    assert found[0] == pytest.approx(expected[0], rel=1e-3)
    np.testing.assert_allclose(found, expected, rtol=5e-2)
    assert places(trainer) == {"cuda"}
    write_tensors(tmp_path / "state.pt", trainer.state())
    resumed.restore(load_checkpoint(tmp_path / "state.pt"))
    assert resumed.step(1.0) == pytest.approx(trainer.step(1.0), rel=1e-2)
    assert places(resumed) == {"cuda"}


def test_states_are_written_as_tensors_of_the_cpu(elsewhere):
    there = torch.zeros(2, device=ELSEWHERE)
    state = on_cpu({"a": there, "b": [1, {"c": (there, "d")}], "e": None})
    tensors = [value for value in flat(state) if isinstance(value, Tensor)]
    assert [t.device.type for t in tensors] == ["cpu", "cpu"]
    assert (state["b"][0], state["b"][1]["c"][1], state["e"]) == (1, "d", None)


@pytest.mark.parametrize(
    ("installed", "here", "reason"),
    [(False, True, "gsplat is not installed; pip install"), (True, False, "torch sees no CUDA device")],
)
def test_a_device_that_is_not_here_is_refused_in_one_line(installed, here, reason, monkeypatch):
    monkeypatch.setattr(gsplat_backend.importlib.util, "find_spec", lambda name: name if installed else None)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: here)
    with pytest.raises(BadRunError, match="found no GPU to train on") as caught:
        reconstruct(Path("rec"), Path("run"), ReconstructionConfig(device=CUDA), lambda stage: silent)
    assert reason in str(caught.value)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)
    assert in_request_words(str(caught.value)).endswith("expected gsplat and a CUDA device; take `device` cpu")
