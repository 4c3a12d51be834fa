"""Views nobody captured: error against the distance from the nearest camera that trained, between and beyond them.

The scene is rendered anew from each viewpoint by the ray caster, so that there is truth wherever one looks from. Lines
of viewpoints start at the centre of the array and at a corner camera; each looks at the scene's centre.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from acquisition.bench_document import BenchDocument
from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.scene import Scene
from reconstruction.bench.training import Clip
from reconstruction.evaluation.evaluate import score_view
from reconstruction.evaluation.truth import TruthFrame
from reconstruction.run.folder import RunFolder
from reconstruction.scene_model import SceneModel
from reconstruction.training.checkpoint import load_cloud
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

INSTANTS = (0.125, 0.375, 0.625, 0.875)  # shares of the clip
SAMPLES = 4  # x 4 rays a pixel
SCORES = ("psnr_db", "dynamic_psnr_db", "abs_rel", "dynamic_abs_rel", "empty")
BETWEEN = tuple(np.linspace(-1, 1, 9))  # in half widths of the array, along its middle row
BEYOND_M = (0.05, 0.1, 0.2, 0.4, 0.8, 1.2)  # sideways and upwards from a corner camera
FORWARD_M = (0.1, 0.2, 0.4, 0.6, 0.8)  # from the centre of the array towards the scene
BACKWARD_M = (0.2, 0.4, 0.8)


@dataclass(frozen=True)
class Viewpoint:
    """A camera that is not in the rig, on a line of them, `distance_m` from the nearest training camera."""

    line: str
    along_m: float
    distance_m: float
    camera: Camera


def viewpoints(rig: Rig, views: Sequence[str], center: Sequence[float]) -> Iterator[Viewpoint]:
    """The lines `between` (the middle row), `beyond` (outwards from a corner), `forward` and `backward`."""
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


def bench_viewpoints(clips: Sequence[Clip], runs: Sequence[RunFolder], progress: Progress) -> BenchDocument:
    """The last state of each run of a clip, from every viewpoint; the rig's poses must be the true ones."""
    document = BenchDocument("viewpoints")
    for i, (clip, run) in enumerate(zip(clips, runs, strict=True)):
        scene, recording = build_scene(clip.scene, clip.seed), Recording.open(clip.path)
        cloud = load_cloud(run.snapshots()[-1])
        found = list(viewpoints(recording.rig, run.plan.views, scene.center))
        for j, viewpoint in enumerate(found):
            scores = _scores(scene, cloud, viewpoint.camera)
            about = {"scene": clip.scene, "seed": clip.seed, "line": viewpoint.line, "method": "auto"}
            place = {"along_m": viewpoint.along_m, "distance_m": viewpoint.distance_m}
            spent_s = run.document["seconds"]["train"]
            document.rows.append({**about, **place, **scores, "seconds": spent_s})
            progress(
                (i + (j + 1) / len(found)) / len(clips), f"{clip.scene}: {viewpoint.line} {viewpoint.along_m:.2f} m"
            )
    _summarise(document)
    document.omissions.append("viewpoints behind the scene or more than 1.2 m from the nearest camera")
    return document


def frames_at(scene: Scene, camera: Camera, instants_s: NDArray[np.float64]) -> list[TruthFrame]:
    """The truth of a viewpoint at the instants."""
    frames = scene.render(camera, instants_s, SAMPLES)
    moving = np.isin(frames.ids, list(scene.movers.values()))
    return [TruthFrame(-1, *found) for found in zip(frames.intensity, frames.depth, moving, strict=True)]


def _scores(scene: Scene, cloud: SceneModel, camera: Camera) -> dict[str, float]:
    """Means over INSTANTS; `empty` is the share of pixels without a surface where there is one."""
    span = cloud.clip.last_s - cloud.clip.first_s
    instants_s = cloud.clip.first_s + span * np.array(INSTANTS)
    rows: list[dict[str, float]] = []
    for instant_s, frame in zip(instants_s, frames_at(scene, camera, instants_s), strict=True):
        view = cloud.look(camera, float(instant_s))
        known = np.isfinite(frame.depth)
        empty = float((known & ~np.isfinite(view.depth)).sum() / max(1, known.sum()))
        rows.append(score_view(view, frame, scene.white) | {"empty": empty})
    found = {score: [row[score] for row in rows if np.isfinite(row[score])] for score in SCORES}
    return {score: float(np.mean(values)) for score, values in found.items() if values}


def _summarise(document: BenchDocument) -> None:
    """Means over the scenes at each place of each line, by centimetres along it."""
    places = dict.fromkeys((row["line"], row["along_m"]) for row in document.rows)
    for line, along_m in places:
        rows = [r for r in document.rows if (r["line"], r["along_m"]) == (line, along_m)]
        for score in SCORES:
            found = [r[score] for r in rows if score in r]
            if found:
                document.summary[f"{line}{100 * along_m:+.0f}cm.{score}"] = float(np.mean(found))
