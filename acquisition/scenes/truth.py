"""Writes `truth/` of a simulated recording: exact light, depth, objects and cameras beside the spikes.

Every k-th plane of each camera has four images [H, W]: `camRC/000120.npy` (float32, the light at (120 + 0.5) / rate),
`depth_000120.npy` (float32), `id_000120.npy` (int8) and `blur_000120.npy` (float32, the mean light of the exposure that
`scene.json` states). Viewpoints that no camera of the rig has are `novelN/`, without blur. `cameras.json` is
nerfstudio's and exact. The light is the paper's clean frame (CI), the blur its blurred frame (BI).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from acquisition.durable import write_array, write_durably, write_json
from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.scenes.view import Scenery
from acquisition.spikes.sensor import SensorKind
from rigs.camera import Camera
from rigs.exchange.nerfstudio import dump_transforms
from rigs.rig import Rig
from rigs.transform import Transform

BLUR_PLANES = 32  # exposure of a blurred frame, centred on the instant
BLUR_STRIDE = 4  # planes between the frames that a blurred frame is the mean of
BLUR_SAMPLES = 2  # rays a side of a pixel of a blurred frame
EVERY, MOST_INSTANTS = 20, 200  # planes between true frames, and frames of a camera: 1.6 MB each at 400x250
NOVEL_REACH = ((-0.5, -0.5), (1.25, -0.4))  # places in half widths of the rig: between the cameras, and beside them


def stride_of(planes: int) -> int:
    """Return the planes between true frames of a recording: EVERY, or as many times that as keep MOST_INSTANTS."""
    return EVERY * max(1, -(-planes // (EVERY * MOST_INSTANTS)))


def write_truth(
    scene: Scenery,
    rig: Rig,
    ticks: int,
    every: int,
    folder: Path,
    progress: Progress = silent,
    *,
    samples: int = 4,
    sensor: SensorKind = "real",
) -> None:
    """Fill the new `folder` with the truth of planes 0, `every`, ... below `ticks`, by samples x samples rays a pixel.

    Raises BadRecordingError where the folder exists or there is nothing to write, DiskError when the disk refuses.
    """
    if ticks < 1 or every < 1:
        raise BadRecordingError(f"found {ticks} ticks and truth every {every} planes", "at least 1 of each")
    if folder.exists():
        raise BadRecordingError("exists already", "a new folder", "move it away", where=folder)
    planes = list(range(0, ticks, every))
    cameras = (*rig.cameras, *novel_cameras(scene, rig))
    for number, camera in enumerate(cameras):
        progress(number / len(cameras), f"truth of {camera.id}")
        (folder / camera.id).mkdir(parents=True)
        _write_views(scene, rig, camera, planes, folder, samples)
        if camera.id in rig.ids:
            _write_blur(scene, rig, camera, planes, folder)
    write_durably(folder / "cameras.json", dump_transforms(cameras))
    write_json(folder / "scene.json", _description(scene, rig, ticks, every) | {"sensor": sensor, "samples": samples})
    progress(1.0, f"truth of {len(cameras)} views, {len(planes)} instants each")


def novel_cameras(scene: Scenery, rig: Rig) -> tuple[Camera, ...]:
    """Return viewpoints `novel0`, ... that look at the scene's centre with the lens of the rig's first camera."""
    centers = np.array([camera.center for camera in rig.cameras])
    middle = (centers.min(axis=0) + centers.max(axis=0)) / 2
    reach = np.maximum((centers.max(axis=0) - centers.min(axis=0)) / 2, 0.1)
    places = [middle + reach * (x, y, 0) for x, y in NOVEL_REACH]
    return tuple(
        replace(rig.cameras[0], id=f"novel{n}", serial="", cam_from_rig=Transform.looking_at(place, scene.center))
        for n, place in enumerate(places)
    )


def _write_views(scene: Scenery, rig: Rig, camera: Camera, planes: list[int], folder: Path, samples: int) -> None:
    view = scene.view(camera, samples)
    for plane in planes:
        frames = view.frames(np.array([rig.clock.instant_s(plane)]))
        for prefix, image in (("", frames.intensity), ("depth_", frames.depth), ("id_", frames.ids)):
            write_array(folder / camera.id / f"{prefix}{plane:06d}.npy", image[0])


def _write_blur(scene: Scenery, rig: Rig, camera: Camera, planes: list[int], folder: Path) -> None:
    view = scene.view(camera, BLUR_SAMPLES)
    offsets = np.arange(-BLUR_PLANES / 2 + BLUR_STRIDE / 2, BLUR_PLANES / 2, BLUR_STRIDE)
    for plane in planes:
        light = view.light(np.array([rig.clock.instant_s(plane + offset) for offset in offsets]))
        blur = light.mean(axis=0, dtype=np.float64).astype(np.float32)
        write_array(folder / camera.id / f"blur_{plane:06d}.npy", blur)


def _description(scene: Scenery, rig: Rig, ticks: int, every: int) -> dict[str, object]:
    return {
        "scene": scene.name,
        "seed": scene.seed,
        "white": scene.white,
        "ticks": ticks,
        "tick_rate_hz": rig.tick_rate_hz,
        "every": every,
        "blur": {"window_ticks": BLUR_PLANES, "stride_ticks": BLUR_STRIDE, "samples": BLUR_SAMPLES},
        **scene.description(),
    }
