"""Times the native rasterizer against its arithmetic and its torch reference, and a whole step part by part."""

import math
import time
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from acquisition.bench_document import BenchDocument, fastest_s
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.losses.picture import PictureLoss, Target, picture_loss
from reconstruction.native import kernels_alone
from reconstruction.rendering.native import Work, work_of
from reconstruction.rendering.render import Backend, Rendering, render
from reconstruction.rendering.result import Instantaneous
from reconstruction.scene_model import TimeSpan
from reconstruction.training.adam import Adam
from rigs.camera import Camera
from rigs.toml import catalog_rig

COUNTS = (20_000, 60_000)
RADIUS_PX = 5.0  # mean 3-sigma radius of a Gaussian
REFERENCE = (500, 100, 64)  # Gaussians, width and height at which the reference is timed
REPEATS = 30
# Additions and multiplications for each pixel that a splat reaches. Forward: u, v 6, exponent 5, exp 13, cap 1,
# weight 1, sums 5. Backward: the same without the sums, 7 for d and B, 3 for g, 22 for the moments.
FORWARD_FLOP, BACKWARD_FLOP = 31, 58
STORED_BYTES = 48  # bytes of a stored Gaussian
MOVING = 0.4  # share of the Gaussians that move
WHITE = 0.6  # brightest light, in spikes per tick
INSTANT_S = 0.4
LOSS = "loss and its gradient"  # torch beside a kernel; every other part is a native call
PARTS = ("motion", "renderer", LOSS, "renderer gradient", "motion gradient", "Adam")


def bench_rasterizer() -> BenchDocument:
    """Time random clouds before the lab rig's centre camera at 400x250: intensity, depth and alpha.

    `forward_ms`, `backward_ms` and `x_reference` are on one thread, `steps_per_s` (motion, rendering, L1 and SSIM, the
    gradients of all, Adam) on all. `..._of_limit` is the useful arithmetic and traffic at the rates of a matrix product
    and a copy, over the time taken; `step_in_kernels` the share of a step outside the loss, which is partly torch's.
    """
    document = BenchDocument("rasterizer")
    camera, threads = catalog_rig("lab3x3").camera("cam11"), torch.get_num_threads()
    try:
        for count in COUNTS:
            cloud = random_cloud(count, camera)
            for used in sorted({1, threads}):
                torch.set_num_threads(used)
                document.rows += [_kernel_row(cloud, camera, used), *_step_rows(cloud, camera, used)]
        torch.set_num_threads(1)
        times = _against_reference(camera)
    finally:
        torch.set_num_threads(threads)
    document.rows += times
    document.summary = _summary(document.rows)
    document.omissions.append("a training step also composes its target image: see `bench training`")
    return document


def random_cloud(count: int, camera: Camera) -> Instantaneous:
    """Return Gaussians of all opacities, 1.2 to 3.2 m before `camera`."""
    generator = torch.Generator().manual_seed(count)
    z = 1.2 + 2 * torch.rand(count, generator=generator)
    x = (torch.rand(count, generator=generator) - 0.5) * camera.width / camera.fx * z
    y = (torch.rand(count, generator=generator) - 0.5) * camera.height / camera.fy * z
    scales = (RADIUS_PX / 3 / camera.fx * z).log()[:, None] + 0.3 * torch.randn(count, 3, generator=generator)
    means = camera.cam_from_rig.inverse().apply(torch.stack([x, y, z], 1).numpy())
    return Instantaneous(
        torch.from_numpy(means).float(),
        torch.randn(count, 4, generator=generator),
        scales,
        torch.rand(count, generator=generator),
        0.6 * torch.rand(count, 1, generator=generator),
    )


def seconds_of(cloud: Instantaneous, camera: Camera, backend: Backend, repeats: int) -> tuple[float, float]:
    """Return the seconds of the fastest forward pass and of the fastest backward pass."""
    leaves = Instantaneous(*(t.clone().requires_grad_(True) for t in cloud))
    forward, backward = [], []
    for _ in range(repeats + 1):
        started = time.perf_counter()
        rendering = render(leaves, camera, backend=backend)
        rendered = time.perf_counter()
        loss = rendering.intensity.sum() + rendering.depth.sum()
        summed = time.perf_counter()
        loss.backward()
        forward.append(rendered - started)
        backward.append(time.perf_counter() - summed)
    assert all(math.isfinite(s) for s in (*forward, *backward))
    return min(forward[1:]), min(backward[1:])


def _kernel_row(cloud: Instantaneous, camera: Camera, threads: int) -> dict:
    forward, backward = seconds_of(cloud, camera, "native", REPEATS)
    work = work_of(cloud, camera)
    limits = _limits_s(work, len(cloud.means), camera, threads)
    return {
        "method": "native",
        "gaussians": len(cloud.means),
        "threads": threads,
        "forward_s": forward,
        "backward_s": backward,
        "seconds": forward + backward,
        "forward_limit_s": limits[0],
        "backward_limit_s": limits[1],
        **work._asdict(),
    }


def _limits_s(work: Work, count: int, camera: Camera, threads: int) -> tuple[float, float]:
    """Return the seconds that the useful work would take forward and backward at this machine's best rates."""
    size = 768
    a, b = (torch.rand(size, size) for _ in range(2))
    flop_per_s = 2 * size**3 / fastest_s(lambda: a @ b, 10)
    block = torch.zeros(4_000_000)
    target = torch.empty_like(block)
    bytes_per_s = 2 * 4 * len(block) / fastest_s(lambda: target.copy_(block), 10)
    images = 3 * 4 * camera.width * camera.height
    forward = max(work.pixels * FORWARD_FLOP / flop_per_s, (count * STORED_BYTES + images) / bytes_per_s)
    return forward, max(work.pixels * BACKWARD_FLOP / flop_per_s, (2 * count * STORED_BYTES + images) / bytes_per_s)


def _step_rows(cloud: Instantaneous, camera: Camera, threads: int) -> list[dict]:
    step, taken = Step(cloud, camera), []
    for _ in range(REPEATS):
        started = time.perf_counter()
        step.whole()
        whole = time.perf_counter() - started
        taken.append({"step": whole} | {f"step: {name}": seconds for name, seconds in step.parts().items()})
    shared = {"gaussians": len(cloud.means), "threads": threads}
    return [{"method": name, **shared, "seconds": min(t[name] for t in taken)} for name in taken[0]]


def _against_reference(camera: Camera) -> list[dict]:
    count, width, height = REFERENCE
    small = camera.scaled(width, height)
    cloud = random_cloud(count, small)
    times = {
        "native": seconds_of(cloud, small, "native", REPEATS),
        "reference": seconds_of(cloud, small, "reference", 2),
    }
    return [{"method": f"{name}, {count} at {width}x{height}", "seconds": sum(s)} for name, s in times.items()]


def _summary(rows: list[dict]) -> dict[str, float]:
    def found(method: str, count: int, pick: Callable = min) -> dict:
        rows_of = [row for row in rows if row["method"] == method and row.get("gaussians") == count]
        return pick(rows_of, key=lambda row: row["threads"])

    one, step = found("native", COUNTS[0]), found("step", COUNTS[0], max)
    native, reference = rows[-2:]
    parts = [found(f"step: {name}", COUNTS[0], max)["seconds"] for name in PARTS]
    loss = parts[PARTS.index(LOSS)]
    return {
        "gaussians": COUNTS[0],
        "forward_ms": 1e3 * one["forward_s"],
        "backward_ms": 1e3 * one["backward_s"],
        "forward_of_limit": one["forward_limit_s"] / one["forward_s"],
        "backward_of_limit": one["backward_limit_s"] / one["backward_s"],
        "lane_use": one["pixels"] / (16 * one["in_blocks"]),
        "x_reference": reference["seconds"] / native["seconds"],
        "two_thread_speedup": one["seconds"] / found("native", COUNTS[0], max)["seconds"],
        "steps_per_s": 1 / step["seconds"],
        "steps_per_s@60k": 1 / found("step", COUNTS[1], max)["seconds"],
        "step_in_kernels": 1 - loss / sum(parts),
    }


def dynamic_cloud(cloud: Instantaneous) -> DynamicCloud:
    """Return `cloud` with its last Gaussians moving a little, alive throughout, in a clip of one second."""
    still = round((1 - MOVING) * len(cloud.means))
    stored = cloud._replace(opacities=cloud.opacities.clamp(0.01, 0.99).logit())
    motion = PolynomialMotion.at_rest(torch.full((len(cloud.means) - still,), 0.5), duration=1.0)
    return DynamicCloud(
        GaussianCloud(*(t[:still].clone() for t in stored)),
        GaussianCloud(*(t[still:].clone() for t in stored)),
        motion,
        TimeSpan(0.0, 1.0),
    )


def loss_of(rendering: Rendering, target: Tensor) -> Tensor:
    """Return the loss of a render against its target [H, W], as in training."""
    seen = rendering.intensity[..., 0], rendering.depth, rendering.alpha
    return picture_loss(seen, Target(target), PictureLoss(WHITE))[0]


class Step:
    """A cloud, a view and its target, which can be stepped as a whole or in parts."""

    def __init__(self, cloud: Instantaneous, camera: Camera):
        self.cloud, self.camera = dynamic_cloud(cloud), camera
        generator = torch.Generator().manual_seed(0)
        self.target = WHITE * torch.rand(camera.height, camera.width, generator=generator)
        self.leaves = [t.requires_grad_(True) for _, t in self.cloud.tensors()]
        self.adam = Adam([{"params": [leaf], "lr": 1e-6} for leaf in self.leaves])

    @kernels_alone()
    def whole(self) -> None:
        """Take one step as training does."""
        self.adam.zero_grad(set_to_none=True)
        loss_of(render(self.cloud.at(INSTANT_S), self.camera), self.target).backward()
        self.adam.step()

    @kernels_alone()
    def parts(self) -> dict[str, float]:
        """Take one step and return the seconds of each part."""
        seconds: dict[str, float] = {}

        def timed(name: str, work: Callable[[], Any]) -> Any:
            started = time.perf_counter()
            done = work()
            seconds[name] = time.perf_counter() - started
            return done

        self.adam.zero_grad(set_to_none=True)
        now = timed("motion", lambda: self.cloud.at(INSTANT_S))
        cut = Instantaneous(*(t.detach().requires_grad_(True) for t in now))
        rendering = timed("renderer", lambda: render(cut, self.camera))
        image = rendering._replace(intensity=rendering.intensity.detach().requires_grad_(True))
        (slope,) = timed(LOSS, lambda: torch.autograd.grad(loss_of(image, self.target), image.intensity))
        slopes = timed("renderer gradient", lambda: torch.autograd.grad(rendering.intensity, cut, slope))
        timed("motion gradient", lambda: torch.autograd.backward(now, slopes))
        timed("Adam", self.adam.step)
        assert tuple(seconds) == PARTS
        return seconds
