"""The native rasterizer: milliseconds forward and backward, against its torch reference, on one thread and two."""

from __future__ import annotations

import math

import torch

from acquisition.bench_document import BenchDocument, fastest_s
from reconstruction.gaussians.dynamic import Instantaneous
from reconstruction.rendering.render import render
from rigs.camera import Camera
from rigs.toml import catalog_rig

COUNTS = (5_000, 20_000, 60_000)
RADIUS_PX = 5.0  # mean 3-sigma radius
REFERENCE = (500, 100, 64)  # Gaussians, width, height the reference is timed at


def bench_rasterizer() -> BenchDocument:
    """Random clouds before the lab rig's centre camera at 400x250, intensity, depth and alpha."""
    document = BenchDocument("rasterizer")
    camera = catalog_rig("lab3x3").camera("cam11")
    threads = torch.get_num_threads()
    for count in COUNTS:
        for used in sorted({1, threads}):
            torch.set_num_threads(used)
            forward, both = _seconds(_cloud(count, camera), camera, "native")
            document.rows.append(
                {"method": "native", "gaussians": count, "threads": used, "forward_s": forward, "seconds": both}
            )
    torch.set_num_threads(threads)
    one, all_threads = (r for r in document.rows if r["gaussians"] == 20_000)
    count, width, height = REFERENCE
    small = camera.scaled(width, height)
    cloud = _cloud(count, small)
    times = {backend: _seconds(cloud, small, backend)[1] for backend in ("native", "reference")}
    document.rows += [{"method": f"{k}, {count} at {width}x{height}", "seconds": v} for k, v in times.items()]
    document.summary = {
        "gaussians": 20_000,
        "forward_ms": 1e3 * all_threads["forward_s"],
        "backward_ms": 1e3 * (all_threads["seconds"] - all_threads["forward_s"]),
        "x_reference": times["reference"] / times["native"],
        "two_thread_speedup": one["seconds"] / all_threads["seconds"],
        "steps_per_s": 1 / all_threads["seconds"],
    }
    document.omissions.append(
        "steps_per_s is render and gradient alone; the whole training step is in `bench training`"
    )
    return document


def _cloud(count: int, camera: Camera) -> Instantaneous:
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


def _seconds(cloud: Instantaneous, camera: Camera, backend: str) -> tuple[float, float]:
    """Seconds of a forward pass alone, and of forward and backward together."""
    leaves = Instantaneous(*(t.clone().requires_grad_(True) for t in cloud))

    def forward() -> torch.Tensor:
        rendering = render(leaves, camera, backend=backend)  # type: ignore[arg-type]
        return rendering.intensity.sum() + rendering.depth.sum()

    def both() -> None:
        forward().backward()

    repeats = 5 if backend == "native" else 2
    seconds = fastest_s(forward, repeats), fastest_s(both, repeats)
    assert all(math.isfinite(s) for s in seconds)
    return seconds
