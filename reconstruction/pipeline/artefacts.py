"""The artefacts that several stages read, each by the one file name it has in a run folder.

The plan stage writes LIGHT and MOVING; poses FOUND_RIG and FOUND_POINTS; images BACKGROUND, UNEVEN, and RESPONSE for
the views that are; points STILL, MOVERS, DEPTH, GAINS, EMPTY for the views that are, and BODIES for the model `bases`;
train checkpoint.pt, snapshots/, preview.* and REFINED_RIG; report HELD_OUT_RIG, metrics.json, error_vs_time.*,
report.html, orbit.mp4, thumbnails/, viewer.json, viewer.bin.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from acquisition.durable import write_durably
from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.background import Background
from reconstruction.images.catalogue import GIVEN, ImageMethod, method_for
from reconstruction.images.composite import WHITE_PERCENTILE, CompositeSource
from reconstruction.images.flicker import Light
from reconstruction.images.response import Response
from reconstruction.images.straightened import straightened
from reconstruction.lenses.straight import straightening, views_of
from reconstruction.parallel import each
from reconstruction.run.decisions import Plan
from reconstruction.run.folder import RunFolder
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.toml import dump_rig, load_rig

LIGHT = "plan/light"  # gain [T] of each plane
MOVING = "plan/moving_{view}"  # pixels [H, W] of a view that ever see a mover
FOUND_POINTS = "poses/points_{field}"  # the points of the initialiser, where the plan starts from them
DEPTH = "points/depth_{view}"  # confirmed depth [H, W] of a view in m, NaN where none is
EMPTY = "points/empty_{view}"  # pixels [H, W] in which nothing is, and nothing ever moves
BACKGROUND = "images/{field}_{view}"  # a `Background`
RESPONSE = "images/response_{field}_{view}"  # a `Response` of a view whose pixels are not all alike and good
UNEVEN = "images/uneven"  # which of the plan's views [V] have one
GAINS = "points/gains"  # the gains [V] of the plan's views where they were found to differ, else ones
STILL, MOVERS = "points/still_{field}", "points/moving_{field}"  # `Points`
BODIES = "points/bodies_{field}"  # `Bodies`
FOUND_RIG, REFINED_RIG, HELD_OUT_RIG = "poses/rig.toml", "poses/refined.toml", "poses/held_out.toml"
SWEPT = "interpolated"  # image method by which points are found where the target images are given
Mask = NDArray[np.bool_]
Arrays = TypeVar("Arrays")


def read_light(run: RunFolder) -> Light:
    """Read the gain of each plane."""
    return Light(run.read_array(LIGHT))


def write(run: RunFolder, name: str, arrays: object, view: str = "") -> None:
    """Write every field of a dataclass of arrays as the artefact `name`."""
    for f in fields(arrays):  # pyright: ignore[reportArgumentType]
        run.write_array(name.format(field=f.name, view=view), getattr(arrays, f.name))


def read(run: RunFolder, name: str, kind: type[Arrays], view: str = "") -> Arrays:
    """Read a dataclass of arrays that `write` wrote."""
    return kind(*(run.read_array(name.format(field=f.name, view=view)) for f in fields(kind)))  # pyright: ignore[reportArgumentType]


def read_views(
    run: RunFolder, recording: Recording, *, gained: bool = True
) -> dict[str, tuple[Camera, CompositeSource]]:
    """Return the pinholes that reconstruction works in and what they see, by the id of the training camera.

    They are the cameras and the sources of `read_sources`, but straightened where a lens bends.
    """
    return straight_views(recording, read_sources(run, recording, gained=gained))


def straight_views(
    recording: Recording, sources: Mapping[str, CompositeSource]
) -> dict[str, tuple[Camera, CompositeSource]]:
    """Return the pinhole of every source's camera, by its id, and the source straightened where a lens bends."""
    cameras = views_of(recording.rig, tuple(sources))

    def straight(view: str) -> tuple[Camera, CompositeSource]:
        own, pinhole, source = recording.rig.camera(view), cameras[view], sources[view]
        return pinhole, source if pinhole is own else straightened(source, straightening(own, pinhole))

    return dict(zip(sources, each(straight, sources), strict=True))


def read_empty(run: RunFolder, view: str) -> NDArray[np.float32] | None:
    """Read where nothing is in a view [H, W]: 1 there, else 0; None where something is everywhere."""
    name = EMPTY.format(view=view)
    return run.read_array(name).astype(np.float32) if run.has_array(name) else None


def read_sources(run: RunFolder, recording: Recording, *, gained: bool = True) -> dict[str, CompositeSource]:
    """Return the images of every training camera, by its id, from the artefacts of the plan and images stages.

    `gained`: with the gains that the points stage has found taken out.
    """
    plan, light, responses, sources = run.plan, read_light(run), read_responses(run), {}
    for view in plan.views:
        stream, moving = recording.stream(view), run.read_array(MOVING.format(view=view))
        method, still = short_images(plan, stream, moving), read(run, BACKGROUND, Background, view)
        sources[view] = CompositeSource(stream, still, moving, method, light, response=responses.get(view))
    if gained and run.has_array(GAINS):
        gains = dict(zip(plan.views, run.read_array(GAINS).tolist(), strict=True))
        return {view: source.dimmed(gains[view]) for view, source in sources.items()}
    return sources


def write_responses(run: RunFolder, responses: Mapping[str, Response]) -> None:
    """Write the responses of the views that have one; the pixels of the others are all alike and good."""
    for view, response in responses.items():
        write(run, RESPONSE, response, view)
    run.write_array(UNEVEN, np.array([view in responses for view in run.plan.views]))


def read_responses(run: RunFolder) -> dict[str, Response]:
    """Read the responses of the views that have one; none in a run of an earlier revision."""
    if not run.has_array(UNEVEN):
        return {}
    uneven = zip(run.plan.views, run.read_array(UNEVEN), strict=True)
    return {view: read(run, RESPONSE, Response, view) for view, has in uneven if has}


def gains_differ(run: RunFolder) -> bool:
    """Return whether the points stage has found that the cameras differ in gain."""
    return run.has_array(GAINS) and bool((run.read_array(GAINS) != 1).any())


def short_images(plan: Plan, stream: SpikeStream, moving: Mask) -> ImageMethod:
    """Return the method that images what moves; where the target images are given, the one that finds points."""
    method = method_for(SWEPT if plan.images in GIVEN else plan.images, stream.layout, moving)
    if plan.images != "interpolated":
        return method
    return replace(method, make=partial(method.make, half_window=plan.window // 2))


def read_white(run: RunFolder) -> float:
    """Return the intensity shown as white, spikes per tick, from the still images; raises BadRunError without them."""
    return white_of([read(run, BACKGROUND, Background, view) for view in run.plan.views])


def white_of(backgrounds: list[Background]) -> float:
    """Return the 99.9th percentile of the still images, spikes per tick, as a mean over the views."""
    return float(np.mean([np.percentile(still.image, WHITE_PERCENTILE) for still in backgrounds]))


def recording_of(run: RunFolder) -> Recording:
    """Return the recording that a run reads, or the part of it that was asked for, with its cameras as they were."""
    return run.config.part_of(Recording.open(run.recording))


def posed(run: RunFolder, recording: Recording, *, refined: bool = False) -> Recording:
    """Return the recording with the cameras that the poses stage found, or as it is where nothing was to be found.

    `refined`: with those that the training made of them, where it did.
    """
    names = (REFINED_RIG, FOUND_RIG) if refined else (FOUND_RIG,)
    file = next((run.path / name for name in names if (run.path / name).exists()), None)
    return recording if file is None else with_cameras(recording, load_rig(file))


def with_cameras(recording: Recording, rig: Rig) -> Recording:
    """Return the recording with the cameras of `rig` in place of its own; its ticks and calibrations of pixels stay."""
    pixels = {camera.id: camera.pixels for camera in recording.rig.cameras}
    cameras = tuple(replace(c, pixels=pixels[c.id]) for c in rig.cameras)
    return replace(recording, rig=replace(rig, cameras=cameras, first_tick=recording.rig.first_tick))


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig without its files of pixels, which lie beside the recording."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_durably(path, dump_rig(replace(rig, cameras=tuple(replace(c, pixels=None) for c in rig.cameras))))


def write_held_out(run: RunFolder, rig: Rig, camera: Camera) -> None:
    """Write the rig with the held-out camera in its place."""
    cameras = tuple(camera if c.id == camera.id else c for c in rig.cameras)
    write_rig(run.path / HELD_OUT_RIG, replace(rig, cameras=cameras))


def read_held_out(run: RunFolder) -> Camera | None:
    """Return the held-out camera in the place that the report found for it; None where it found none."""
    file = run.path / HELD_OUT_RIG
    holdout = run.config.holdout
    return load_rig(file).camera(holdout) if holdout is not None and file.exists() else None
