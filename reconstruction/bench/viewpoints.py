"""Measures views nobody captured: error against the distance from the nearest camera that trained.

The ray caster renders the scene anew from each viewpoint, so that there is a truth everywhere. Lines of viewpoints
start at the centre of the array and at a corner camera; every viewpoint looks at the scene's centre.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.view import Scenery
from reconstruction.bench.conventions import KnownRecording, means, named
from reconstruction.evaluation.evaluate import score_view
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_cloud
from reconstruction.truth import TruthFrame
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

INSTANTS = (0.125, 0.375, 0.625, 0.875)  # instants, as shares of the clip
SAMPLES = 4  # rays a pixel along each axis
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "empty")
BETWEEN = tuple(np.linspace(-1, 1, 9))  # places along the middle row, in half widths of the array
BEYOND_M = (0.05, 0.1, 0.2, 0.4, 0.8, 1.2)  # distances sideways and upwards from a corner camera
FORWARD_M = (0.1, 0.2, 0.4, 0.6, 0.8)  # distances from the centre of the array towards the scene
BACKWARD_M = (0.2, 0.4, 0.8)  # distances from the centre of the array away from the scene


@dataclass(frozen=True)
class Viewpoint:
    """A camera that is not in the rig: its line, metres along it, and metres from the nearest training camera."""

    line: str
    along_m: float
    distance_m: float
    camera: Camera


def viewpoints(rig: Rig, views: Sequence[str], center: Sequence[float]) -> Iterator[Viewpoint]:
    """Yield the lines `between` (the middle row), `beyond` (outwards from a corner), `forward` and `backward`."""
    cameras = [rig.camera(view) for view in views]
    spots = np.stack([camera.center for camera in cameras])
    middle, half = (spots.max(axis=0) + spots.min(axis=0)) / 2, np.ptp(spots, axis=0) / 2
    corner = spots[np.argmax(((spots - middle)[:, :2] * (1, -1)).sum(axis=1))]
    outwards = (corner - middle) * (1, 1, 0)
    outwards /= np.linalg.norm(outwards)
    ahead = np.asarray(center) - middle
    ahead /= np.linalg.norm(ahead)
    aside = np.array([half[0], 0, 0])
    lines = {
        "between": [(share * half[0], middle + share * aside) for share in BETWEEN],
        "beyond": [(far, corner + far * outwards) for far in BEYOND_M],
        "forward": [(far, middle + far * ahead) for far in FORWARD_M],
        "backward": [(-far, middle - far * ahead) for far in BACKWARD_M],
    }
    for line, places in lines.items():
        for along_m, place in places:
            distance_m = float(np.linalg.norm(spots - place, axis=1).min())
            camera = replace(cameras[0], id=line, serial="", cam_from_rig=Transform.looking_at(place, center))
            yield Viewpoint(line, float(along_m), distance_m, camera)


def bench_viewpoints(runs: Sequence[tuple[KnownRecording, RunFolder]], progress: Progress) -> BenchDocument:
    """Score the last state of each clip's run from every viewpoint; the rig's poses must be the true ones."""
    document = BenchDocument("viewpoints")
    for i, (clip, run) in enumerate(runs):
        scene = build_scene(clip.scene, clip.seed)
        cloud = load_cloud(run.snapshots()[-1])
        found = list(viewpoints(clip.recording.rig, run.plan.views, scene.center))
        for j, viewpoint in enumerate(found):
            about = {"scene": clip.scene, "seed": clip.seed, "line": viewpoint.line, "method": "auto"}
            about |= {"along_m": viewpoint.along_m, "distance_m": viewpoint.distance_m}
            scores = _scores(scene, cloud, viewpoint.camera)
            document.rows.append({**about, **scores, "seconds": run.document.seconds["train"]})
            share = (i + (j + 1) / len(found)) / len(runs)
            progress(share, f"{clip.scene}: {viewpoint.line} {viewpoint.along_m:.2f} m")
    _summarise(document)
    document.omissions.append("viewpoints behind the scene or more than 1.2 m from the nearest camera")
    return document


def _scores(scene: Scenery, cloud: SceneModel, camera: Camera) -> dict[str, float]:
    """Return means over INSTANTS; `empty` is the share of pixels without a surface where there is one."""
    instants_s = np.array([cloud.clip.instant_s(share) for share in INSTANTS])
    frames = scene.render(camera, instants_s, SAMPLES)
    moving = np.isin(frames.ids, list(scene.movers.values()))
    rows: list[dict[str, float]] = []
    for instant_s, *found in zip(instants_s, frames.intensity, frames.depth, moving, frames.ids, strict=True):
        frame, view = TruthFrame(-1, *found), cloud.look(camera, float(instant_s))
        known = np.isfinite(frame.depth)
        empty = float((known & ~np.isfinite(view.depth)).sum() / max(1, known.sum()))
        rows.append(score_view(view, frame, scene.white) | {"empty": empty})
    return means(rows, SCORES)


def _summarise(document: BenchDocument) -> None:
    """Add means over the scenes at each place of each line, by centimetres along it."""
    for line, along_m in dict.fromkeys((row["line"], row["along_m"]) for row in document.rows):
        rows = [r for r in document.rows if (r["line"], r["along_m"]) == (line, along_m)]
        document.summary |= named(f"{line}{100 * along_m:+.0f}cm", means(rows, SCORES))
