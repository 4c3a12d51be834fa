"""Finds the points that training starts from: the still scene is swept once, the movers at several instants."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from reconstruction.errors import StereoError
from reconstruction.images.background import WINDOWS, dimming
from reconstruction.images.composite import CompositeSource, shrunk
from reconstruction.images.flicker import DARK
from reconstruction.images.noise import still_sigma
from reconstruction.images.scarce import calm_side, calmed
from reconstruction.initialization.beyond import empty, is_open, searched, with_sky
from reconstruction.initialization.points import Points, sample_points
from reconstruction.initialization.pyramid import swept_maps
from reconstruction.initialization.surfaces import with_planes
from reconstruction.initialization.sweep import NOISE, DepthMap, Image, SweepOptions, depth_range_m, filled
from reconstruction.initialization.texture import judge_poses, textured, thinned
from reconstruction.methods.catalogue import METHODS
from reconstruction.parallel import each
from reconstruction.pipeline import artefacts
from reconstruction.pipeline.gains import even_cameras
from reconstruction.pipeline.other_points import Views, leave_unswept, other_points
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from rigs.camera import Camera

LEAST_POINTS = 200  # points of the still scene, where so many were asked for
MOVING_PLANES = 64  # depth hypotheses for movers, at half resolution
Mask = NDArray[np.bool_]


def points_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Sweep the still scene once and the movers at several instants; raises StereoError when too little agrees.

    Points that the plan wants from elsewhere take their place.
    """
    plan, views = run.plan, artefacts.read_views(run, recording, gained=False)
    rng = np.random.default_rng(run.config.seed)
    others = other_points(run, rng)
    rounds = 1 + len(_swept(run, recording))
    if others:
        leave_unswept(run, views)
        still = others.still(views, plan.still_gaussians)
        progress(1 / rounds, f"still scene: {len(still)} points {plan.points}")
    else:
        still = _still_points(run, views, rng, lambda message: progress(1 / rounds, message))
    artefacts.write(run, artefacts.STILL, still)
    views = artefacts.read_views(run, recording)

    def moving() -> Points:
        swept, parts = _swept(run, recording), []
        count = plan.moving_gaussians // max(len(swept), 1)
        for i, plane in enumerate(swept):
            at = plane, recording.rig.clock.instant_s(plane)
            own = others.movers(views, at, count) if others else None
            parts.append(moving_points(*parted(views), at, count, rng) if own is None else own)
            progress((i + 2) / (1 + len(swept)), f"movers at plane {plane}: {len(parts[-1])} points")
        return Points.joined(parts)

    found = moving()
    if plan.model == "bases" and not plan.spans:
        from reconstruction.pipeline.found_bodies import keep_bodies  # torch, which no other model needs here

        bodies = keep_bodies(run, recording, found, moving_planes(recording.planes, plan.model, plan.sweeps))
        progress(1.0, f"{len(bodies)} rigid bodies with {bodies.attached} points; free: {bodies.free}")
    # where no body was kept, the plan has become one of straight paths, which want other sweeps
    artefacts.write(run, artefacts.MOVERS, found if run.plan.sweeps == plan.sweeps else moving())


def _swept(run: RunFolder, recording: Recording) -> list[int]:
    """Return the planes at which the movers of a recording in one piece are swept now, as the plan has become."""
    plan = run.plan
    if not plan.moving_gaussians or plan.spans:
        return []
    return moving_planes(recording.planes, plan.model, plan.sweeps)


def moving_planes(planes: int, model: str, instants: int) -> list[int]:
    """Return the planes at which movers are swept: the middles of equal parts of the clip, or the canonical one."""
    canonical = METHODS[model].canonical
    if canonical is not None:
        return [min(int(canonical * planes), planes - 1)]
    return [int((i + 0.5) * planes / instants) for i in range(instants)]


def parted(views: Views) -> tuple[dict[str, CompositeSource], list[Camera]]:
    """Return the sources by the id of the camera, and the cameras."""
    return {view: source for view, (_, source) in views.items()}, [camera for camera, _ in views.values()]


def _still_points(run: RunFolder, views: Views, rng: np.random.Generator, report: Callable[[str], None]) -> Points:
    """Sweep the backgrounds, and keep each view's depth where two others confirm it and nothing ever moves."""
    sources, cameras = parted(views)
    whites = [source.white for source in sources.values()]
    maps, stills, sure = _still_maps(run, sources, cameras, rng, report)
    voids = [empty(image, mask, float(np.mean(whites))) for image, mask in zip(stills, sure, strict=True)]
    for (view, source), found, void in zip(sources.items(), maps, voids, strict=True):
        still = source.background.trusted & ~source.moving & ~void
        run.write_array(artefacts.DEPTH.format(view=view), np.where(still, found.depth, np.float32(np.nan)))
        if void.any():
            run.write_array(artefacts.EMPTY.format(view=view), void & ~source.moving)
    if any(void.any() for void in voids):
        share = float(np.mean([void.mean() for void in voids]))
        reason = f"{share:.1%} of the pixels see neither light nor texture"
        run.amend("points", Decision("darkness", "kept empty", reason, "none", facts={"share": share}))
    masks = [source.background.trusted & ~void for source, void in zip(sources.values(), voids, strict=True)]
    masks, count = _needed(run, masks, sure, rng)
    points = sample_points([filled(m) for m in maps], stills, masks, count, 0.0, rng)
    least = min(LEAST_POINTS, run.plan.still_gaussians)
    if len(points) < least:
        raise StereoError(f"found {len(points)} points", f"{least}", "check that the scene is lit and stands still")
    return points


def _needed(
    run: RunFolder, wanted: list[Mask], sure: Sequence[Mask], rng: np.random.Generator
) -> tuple[list[Mask], int]:
    """Return where still points are drawn from, and how many; where a plain scene needs fewer than planned, say so."""
    most = run.plan.still_gaussians
    masks, count = thinned(wanted, sure, most, rng)
    count = max(count, min(LEAST_POINTS, most))
    if count < most:
        share = float(np.mean([mask.mean() for mask in sure]))
        reason = f"{share:.0%} of the pixels have texture, and more Gaussians learn the noise of the others"
        decision = Decision("plain surfaces", f"{count:,} still, not {most:,}", reason, "none", facts={"share": share})
        run.amend("points", decision)
    return masks, count


def _still_maps(
    run: RunFolder,
    sources: Mapping[str, CompositeSource],
    cameras: Sequence[Camera],
    rng: np.random.Generator,
    report: Callable[[str], None],
) -> tuple[list[DepthMap], list[Image], list[Mask]]:
    """Return each view's depth of the still scene, its background as it was swept, and where that has texture.

    The gains of the cameras are found on the way, and taken out of the backgrounds.
    """
    sides = [calm_side(s.background.image, len(s.stream)) for s in sources.values()]
    stills = [calmed(s.background.image, side) for s, side in zip(sources.values(), sides, strict=True)]
    noise = NOISE * dimming(float(np.mean([source.white for source in sources.values()])))
    usual = SweepOptions(*depth_range_m(cameras), noise=noise)
    options = searched(cameras, stills, usual)
    maps = swept_maps(cameras, stills, options)
    sources = even_cameras(run, sources, maps)
    stills = [calmed(s.background.image, side) for s, side in zip(sources.values(), sides, strict=True)]
    noises = [_noise(source) / np.float32(side) for source, side in zip(sources.values(), sides, strict=True)]
    seen = [s.straightening.covered if s.straightening else np.True_ for s in sources.values()]
    sure = [textured(a, b, options) & covered for a, b, covered in zip(stills, noises, seen, strict=True)]
    report(f"still scene: {judge_poses(maps, sure)}")
    if is_open(options, usual):
        maps, sure = with_sky(maps, stills, sure, usual)
        reason = f"a view matches better beyond {usual.far_m:.1f} m than within"
        run.amend("points", Decision("depths", "searched to infinity", reason, "none", facts={"usual_m": usual.far_m}))
    return with_planes(maps, stills, noises, sure, options, rng), stills, sure


def _noise(source: CompositeSource) -> Image:
    """Return the deviation between neighbours of a background [H, W], in spikes per tick."""
    whole = len(source.stream)
    planes = np.where(source.moving, max(whole // WINDOWS, 1), whole)
    return still_sigma(source.background.image, planes, ~source.moving)


def moving_points(
    sources: Mapping[str, CompositeSource],
    cameras: Sequence[Camera],
    at: tuple[int, float],
    count: int,
    rng: np.random.Generator,
) -> Points:
    """Return points of movers `at` a plane and its instant in seconds, swept at half resolution.

    Their light is that under the usual light of the scene.
    """
    plane, instant_s = at
    half = [c.scaled(max(1, c.width // 2), max(1, c.height // 2)) for c in cameras]

    def look(one: tuple[CompositeSource, Camera]) -> tuple[Image, Mask]:
        source, small = one
        whole = source.at(plane)
        usual = whole / max(source.light.gains[plane], DARK) if source.light.flickers else whole
        return shrunk(usual, small), shrunk(source.movers(whole, plane).astype(np.float32), small) > 0.5

    images, wanted = zip(*each(look, zip(sources.values(), half, strict=True)), strict=True)
    near, far = depth_range_m(cameras)
    noise = NOISE * dimming(float(np.mean([source.white for source in sources.values()])))
    maps = swept_maps(half, images, SweepOptions(near, far, planes=MOVING_PLANES, noise=noise), wanted)
    return sample_points(maps, images, wanted, count, instant_s, rng)
