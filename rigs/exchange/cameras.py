"""One door for cameras in any of the formats we read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.exchange.colmap import load_model
from rigs.exchange.nerfstudio import Size, load_transforms
from rigs.rig import Poses, Rig
from rigs.tables import located
from rigs.toml import GRID_ID, load_rig, refuse_holes


def load_cameras(
    path: Path,
    tick_rate_hz: float,
    *,
    size: Size | None = None,
    ids: Sequence[str] | None = None,
    poses: Poses = "calibrated",
    name: str | None = None,
) -> Rig:
    """A rig from a `transforms.json`, a COLMAP model folder or a `RIG.toml` (which keeps its own name and poses flag).

    Cameras come in row-major order where all are named camRC. `size` (width, height) is the pictures' size, `ids` the
    cameras there must be, no more and no less. Raises RigError naming the file and the camera that does not fit.
    """
    if path.suffix == ".toml":
        rig = load_rig(path)
        cameras, poses, name = rig.cameras, rig.poses, name or rig.name
        calibration = rig.calibration
    else:
        cameras, calibration = _foreign_cameras(path, size, ids), None
    for camera in cameras:
        if size and (camera.width, camera.height) != tuple(size):
            raise RigError(
                f"{camera.id}: found the size {camera.width}x{camera.height}",
                f"{size[0]}x{size[1]}",
                "give the size the cameras were stated for",
                where=path,
            )
    cameras = _in_order(cameras, path, ids)
    with located(str(path)):
        return Rig(name or path.stem, tick_rate_hz, cameras, poses, calibration)


def _foreign_cameras(path: Path, size: Size | None, ids: Sequence[str] | None) -> tuple[Camera, ...]:
    if path.is_dir():
        return load_model(path)
    if path.suffix == ".json":
        return load_transforms(path, size=size, ids=ids)
    raise RigError("found no cameras", "a transforms.json, a COLMAP model folder or a RIG.toml", where=path)


def _in_order(cameras: tuple[Camera, ...], path: Path, ids: Sequence[str] | None) -> tuple[Camera, ...]:
    found = [camera.id for camera in cameras]
    if ids is None:
        refuse_holes(found, str(path))
    elif set(ids) != set(found):
        missing, surplus = sorted(set(ids) - set(found)), sorted(set(found) - set(ids))
        raise RigError(
            f"{path}: found the cameras {', '.join(found)}, expected {', '.join(ids)}"
            + (f"; missing: {', '.join(missing)}" if missing else "")
            + (f"; not expected: {', '.join(surplus)}" if surplus else "")
        )
    if all(GRID_ID.fullmatch(camera_id) for camera_id in found):
        return tuple(sorted(cameras, key=lambda camera: camera.id))
    return cameras
