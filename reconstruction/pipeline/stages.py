"""What each stage reads and writes.

plan -> plan/moving_camRC.npy, plan/light.npy; images -> images/{image,trusted,stuck}_camRC.npy; points ->
points/{still,moving}_*.npy, points/depth_camRC.npy, and points/bodies_*.npy for the model `bases`; train ->
checkpoint.pt, snapshots/; report -> metrics.json, error_vs_time.*, report.html, orbit.mp4, thumbnails/, viewer.json,
viewer.bin.
"""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import StereoError
from reconstruction.images.background import Background, background
from reconstruction.images.catalogue import GIVEN, ImageMethod, method_for
from reconstruction.images.composite import CompositeSource
from reconstruction.images.estimate import shrunk
from reconstruction.images.flicker import Light
from reconstruction.initialization.consistency import consistent
from reconstruction.initialization.holes import filled
from reconstruction.initialization.points import Points, sample_points
from reconstruction.initialization.sweep import (
    DepthMap,
    SweepOptions,
    depth_range_m,
    neighbours,
    sweep_view,
)
from reconstruction.methods.catalogue import METHODS
from reconstruction.run.folder import RunFolder
from reconstruction.run.plan import INSTANTS, Plan, make_plan
from rigs.camera import Camera

CANONICAL = 3  # Gaussians with a time window for one that lives through the clip: as many are seen at once
LEAST_POINTS = 200
LEAST_SHARE = 0.3  # of the pixels that must find a depth; shuffled poses leave 0.12 to 0.27, right ones 0.8
SWEPT = "interpolated"  # images that points are found in where the targets are given
MOVING_PLANES = 64  # depth hypotheses for movers, at half resolution

if TYPE_CHECKING:
    from reconstruction.initialization.bodies import Bodies

Image = NDArray[np.float32]


def plan_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Decide what this scene needs and keep each view's moving pixels."""
    streams = {c: recording.stream(c) for c in recording.camera_ids if c != run.config.holdout}
    plan, masks, light = make_plan(run.config, recording.rig, streams)
    run.write_array("plan/light", light.gains)
    for view, mask in masks.items():
        run.write_array(f"plan/moving_{view}", mask)
    run.document["plan"] = plan.to_json()
    progress(1.0, "\n".join(map(str, plan.decisions)))


def images_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Keep the background of every training view: what stays when the movers are taken away."""
    views, light = run.plan.views, Light(run.read_array("plan/light"))
    for i, view in enumerate(views):
        found = background(recording.stream(view), run.read_array(f"plan/moving_{view}"), light)
        for f in fields(Background):
            run.write_array(f"images/{f.name}_{view}", getattr(found, f.name))
        progress((i + 1) / len(views), f"background of {view}, {int(found.stuck.sum())} stuck pixels")


def composite_sources(run: RunFolder, recording: Recording) -> dict[str, CompositeSource]:
    """The target images of every training view, from the artefacts of the plan and images stages."""
    plan, light = run.plan, Light(run.read_array("plan/light"))
    sources = {}
    for view in plan.views:
        stream, moving = recording.stream(view), run.read_array(f"plan/moving_{view}")
        still = Background(*(run.read_array(f"images/{f.name}_{view}") for f in fields(Background)))
        sources[view] = CompositeSource(stream, still, moving, short_images(plan, stream, moving), light)
    return sources


def short_images(plan: Plan, stream: SpikeStream, moving: NDArray[np.bool_]) -> ImageMethod:
    """How the plan sees what moves; where the targets are given, how points are found."""
    return method_for(SWEPT if plan.images in GIVEN else plan.images, stream.layout, moving)


def points_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Sweep the still scene once and the movers at several instants; raises StereoError when too little agrees."""
    plan, rig = run.plan, recording.rig
    sources = composite_sources(run, recording)
    rng = np.random.default_rng(run.config.seed)
    cameras = [rig.camera(view) for view in plan.views]
    options = SweepOptions(*depth_range_m(cameras))
    planes = moving_planes(recording.planes, plan.model) if plan.moving_gaussians else []
    rounds = 1 + len(planes)
    stills = [sources[view].background.image for view in plan.views]
    maps = swept_maps(cameras, stills, options)
    share = float(np.mean([np.isfinite(m.depth).mean() for m in maps]))
    progress(1 / rounds, f"still scene: {share:.0%} of the pixels have a depth that two views confirm")
    masks = [sources[view].background.trusted for view in plan.views]
    _write_depths(run, sources, maps)
    whole = [filled(m) for m in maps]
    _write_points(run, "still", sample_points(whole, stills, masks, plan.still_gaussians, 0.0, rng), share)
    parts = []
    count = plan.moving_gaussians // (CANONICAL if len(planes) == 1 else INSTANTS)
    for i, plane in enumerate(planes):
        parts.append(_moving_points(sources, cameras, plane, recording, count, rng))
        progress((i + 2) / rounds, f"movers at plane {plane}: {len(parts[-1])} points")
    moving = Points.joined(parts)
    _write_points(run, "moving", moving, 1.0)
    if plan.model == "bases":
        from reconstruction.initialization.bodies import find_bodies  # torch, which no other model needs here

        instants_s = [rig.clock.instant_s(plane) for plane in moving_planes(recording.planes, plan.model)]
        _write_bodies(run, find_bodies(moving, instants_s), progress)


def moving_planes(planes: int, model: str) -> list[int]:
    """The planes at which movers are swept: the middles of equal parts of the clip, or the canonical one."""
    canonical = METHODS[model].canonical
    if canonical is not None:
        return [min(int(canonical * planes), planes - 1)]
    return [int((i + 0.5) * planes / INSTANTS) for i in range(INSTANTS)]


def read_points(run: RunFolder, kind: str) -> Points:
    """The points of kind `still` or `moving`."""
    return Points(*(run.read_array(f"points/{kind}_{f.name}") for f in fields(Points)))


def read_bodies(run: RunFolder) -> Bodies:
    """The rigid bodies of a run whose model is `bases`."""
    from reconstruction.initialization.bodies import Bodies

    return Bodies(*(run.read_array(f"points/bodies_{f.name}") for f in fields(Bodies)))


def swept_maps(cameras: list[Camera], images: list[Image], options: SweepOptions) -> list[DepthMap]:
    """Depth of every view against its nearest neighbours, checked for consistency."""
    maps = []
    for i, camera in enumerate(cameras):
        others = [(c, images[j]) for j, c in enumerate(cameras) if j != i]
        near = [others[j] for j in neighbours(camera, [c for c, _ in others])]
        maps.append(sweep_view((camera, images[i]), near, options))
    return consistent(maps, options)


def _moving_points(
    sources: dict[str, CompositeSource],
    cameras: list[Camera],
    plane: int,
    recording: Recording,
    count: int,
    rng: np.random.Generator,
) -> Points:
    """Points of what moves at one plane, swept at half resolution."""
    half = [c.scaled(max(1, c.width // 2), max(1, c.height // 2)) for c in cameras]
    whole = [s.at(plane) for s in sources.values()]
    seen = [s.movers(image, plane).astype(np.float32) for s, image in zip(sources.values(), whole, strict=True)]
    images, masks = ([shrunk(a, c) for a, c in zip(some, half, strict=True)] for some in (whole, seen))
    near, far = depth_range_m(cameras)
    maps = swept_maps(half, images, SweepOptions(near, far, planes=MOVING_PLANES))
    return sample_points(maps, images, [mask > 0.5 for mask in masks], count, recording.rig.clock.instant_s(plane), rng)


def _write_depths(run: RunFolder, sources: dict[str, CompositeSource], maps: list[DepthMap]) -> None:
    """Keep the depth of each view where two others confirmed it and nothing ever moves; NaN elsewhere."""
    for (view, source), found in zip(sources.items(), maps, strict=True):
        still = source.background.trusted & ~source.moving
        run.write_array(f"points/depth_{view}", np.where(still, found.depth, np.float32(np.nan)))


def _write_bodies(run: RunFolder, bodies: Bodies, progress: Progress) -> None:
    """Keep the bodies, and say in `run.json` how many points ride on them and why the others do not."""
    for f in fields(bodies):
        run.write_array(f"points/bodies_{f.name}", getattr(bodies, f.name))
    run.document["bodies"] = {"rigid": len(bodies), "attached": bodies.attached, "free": bodies.free}
    progress(1.0, f"{len(bodies)} rigid bodies with {bodies.attached} points; free: {bodies.free}")


def _write_points(run: RunFolder, kind: str, points: Points, share: float) -> None:
    if kind == "still" and (len(points) < LEAST_POINTS or share < LEAST_SHARE):
        raise StereoError(
            f"found {len(points)} points and a confirmed depth in {share:.1%} of the pixels",
            f"{LEAST_POINTS} and {LEAST_SHARE:.0%}",
            "check the poses, and that the scene is lit and textured",
        )
    for f in fields(Points):
        run.write_array(f"points/{kind}_{f.name}", getattr(points, f.name))
