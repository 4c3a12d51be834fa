"""Reads cameras in any of the formats the project knows."""

import os
from collections.abc import Sequence
from pathlib import Path

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.exchange.colmap import load_model
from rigs.exchange.nerfstudio import Size, load_transforms
from rigs.rig import Rig
from rigs.toml import GRID_ID, load_rig, refuse_holes


def load_cameras(path: Path, tick_rate_hz: float, *, size: Size | None = None, ids: Sequence[str] | None = None) -> Rig:
    """Read a rig from a `transforms.json`, a COLMAP model folder or a `RIG.toml`.

    A `RIG.toml` keeps its own name and poses flag. Cameras come in row-major order where all are named camRC. `size`
    (width, height) is the pictures' size, `ids` the cameras there must be, no more and no less. Raises RigError naming
    the file and the camera that does not fit.
    """
    name, poses, calibration = os.fsencode(path.stem).decode(errors="replace"), "calibrated", None
    if path.suffix == ".toml":
        rig = load_rig(path)
        cameras, poses, name, calibration = rig.cameras, rig.poses, rig.name, rig.calibration
    elif path.is_dir():
        cameras = load_model(path)
    elif path.suffix == ".json":
        cameras = load_transforms(path, size=size, ids=ids)
    else:
        raise RigError("found no cameras", "a transforms.json, a COLMAP model folder or a RIG.toml", where=path)
    for camera in cameras:
        if size and (camera.width, camera.height) != tuple(size):
            found, do = f"found the size {camera.width}x{camera.height}", "give the size the cameras were stated for"
            raise RigError(found, f"{size[0]}x{size[1]}", do, where=f"{path}: {camera.id}")
    cameras = _in_order(cameras, path, ids)
    with RigError.located(path):
        return Rig(name, tick_rate_hz, cameras, poses, calibration)


def _in_order(cameras: tuple[Camera, ...], path: Path, ids: Sequence[str] | None) -> tuple[Camera, ...]:
    found = [camera.id for camera in cameras]
    if ids is None:
        refuse_holes(found, str(path))
    elif set(ids) != set(found):
        missing, surplus = sorted(set(ids) - set(found)), sorted(set(found) - set(ids))
        amiss = [
            f"{kind}: {', '.join(some)}" for kind, some in (("missing", missing), ("not expected", surplus)) if some
        ]
        raise RigError(f"found the cameras {', '.join(found)}", ", ".join(ids), "; ".join(amiss), where=path)
    if all(GRID_ID.fullmatch(camera_id) for camera_id in found):
        return tuple(sorted(cameras, key=lambda camera: camera.id))
    return cameras
