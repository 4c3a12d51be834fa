"""nerfstudio's `transforms.json`: camera-to-world matrices in OpenGL axes (x right, y up, z backward)."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.lens import NAMES, LensModel, shortened
from rigs.tables import Fields
from rigs.transform import Floats, Transform

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
MODELS: dict[str, LensModel] = {
    "OPENCV": "opencv",
    "PINHOLE": "opencv",
    "SIMPLE_PINHOLE": "opencv",
    "OPENCV_FISHEYE": "fisheye",
}
WRITTEN = {"opencv": "OPENCV", "fisheye": "OPENCV_FISHEYE"}
Size = tuple[int, int]  # width, height


@dataclass(frozen=True)
class Frame:
    """A camera (its `cam_from_rig` is `cam_from_world`) and the instant it looks at, seconds on the rig clock."""

    camera: Camera
    instant_s: float


def load_transforms(path: Path, *, size: Size | None = None, ids: Sequence[str] | None = None) -> tuple[Camera, ...]:
    """Read the cameras of a `transforms.json`, in its order; the world becomes the rig frame.

    Frames without `camera_id` take `ids` in order, or camRC row by row where they fill a square grid. `size` stands in
    for a missing `w` and `h`. Raises RigError naming the file, the camera and the field.
    """
    frames = _frames(path)
    names = tuple(ids) if ids is not None else _square_grid(len(frames))
    cameras = []
    for number, frame in enumerate(frames):
        if "camera_id" not in frame.table and number >= len(names):
            found = f"found no camera_id for one of {len(frames)} frames"
            raise RigError(found, do="name every camera", where=frame.where)
        default = names[number] if number < len(names) else None
        cameras.append(_camera(frame, frame.word("camera_id", default), path, size))
    return tuple(cameras)


def load_frames(path: Path) -> list[Frame]:
    """Read the cameras of a `transforms.json` with the `time` of each, in its order; any number, ids may repeat.

    Raises RigError naming the file, the frame and the field, `time` included.
    """
    return [
        Frame(_camera(frame, frame.word("camera_id", f"frame{number}"), path, None), frame.number("time"))
        for number, frame in enumerate(_frames(path))
    ]


def dump_transforms(cameras: Sequence[Camera]) -> str:
    """Return the cameras as the text of a `transforms.json`; reading it back gives the same numbers."""
    model = _common_model(cameras)
    document = {"camera_model": model, "frames": [_frame_table(camera, model) for camera in cameras]}
    return json.dumps(document, indent=1) + "\n"


def dump_frames(frames: Sequence[Frame], pictures: Sequence[str], points: str | None = None) -> str:
    """Return frames, the picture of each and a cloud of points as the text of a `transforms.json`.

    `pictures` and `points` are files relative to it.
    """
    model = _common_model([frame.camera for frame in frames])
    tables = [
        {"file_path": picture, "time": frame.instant_s, **_frame_table(frame.camera, model)}
        for frame, picture in zip(frames, pictures, strict=True)
    ]
    cloud = {"ply_file_path": points} if points else {}
    return json.dumps({"camera_model": model, **cloud, "frames": tables}, indent=1) + "\n"


def _frames(path: Path) -> list[Fields]:
    """Read each frame over the file's own defaults: intrinsics in a frame win over those at the top."""
    try:
        with RigError.reading(path, "give an existing transforms.json"):
            document = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise RigError(f"found text that is not JSON ({error})", "nerfstudio's transforms.json", where=path) from error
    top = Fields(document, str(path))
    entries = [Fields(entry, f"{path}: frame {number}") for number, entry in enumerate(top.list_at("frames"))]
    defaults = {key: value for key, value in top.table.items() if key not in ("frames", "camera_id", "time")}
    return [Fields({**defaults, **entry.table}, entry.where) for entry in entries]


def _square_grid(count: int) -> tuple[str, ...]:
    side = math.isqrt(count)
    if side * side != count or side > 10:
        return ()
    return tuple(f"cam{row}{column}" for row in range(side) for column in range(side))


def _camera(frame: Fields, camera_id: str, path: Path, size: Size | None) -> Camera:
    fields = Fields(frame.table, f"{path}: {camera_id}")
    model = fields.word("camera_model", "OPENCV")
    if model not in MODELS:
        raise RigError(f"found camera_model {model!r}", f"one of {', '.join(MODELS)}", where=fields.where)
    lens, names = MODELS[model], NAMES[MODELS[model]]
    if surplus := [key for key in ("k3", "k4", "p1", "p2") if key not in names and fields.number(key, 0.0)]:
        expected = f"{' '.join(names)} of an {model} lens"
        raise RigError(f"found a lens with {surplus[0]}", expected, "undistort the pictures", where=fields.where)
    width, height = (fields.whole(key, size[axis] if size else None) for axis, key in enumerate("wh"))
    fx = fields.number("fl_x")
    matrix = fields.numbers("transform_matrix", (4, 4))
    with RigError.located(f"{fields.where}: transform_matrix"):
        world_from_cam = Transform(_nearest_rotation(matrix[:3, :3]) @ OPENCV_FROM_OPENGL, matrix[:3, 3])
    distortion = shortened(tuple(fields.number(key, 0.0) for key in names))
    with RigError.located(path):
        places = (fx, fields.number("fl_y", fx), fields.number("cx", width / 2), fields.number("cy", height / 2))
        return Camera(camera_id, width, height, *places, world_from_cam.inverse(), distortion, lens_model=lens)


def _nearest_rotation(matrix: Floats) -> Floats:
    """Undo the rounding of files written with few digits; a matrix that is no rotation to 1e-3 is returned as it is."""
    if not 1e-9 < np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-3:
        return matrix
    left, _, right = np.linalg.svd(matrix)
    return left @ right


def _common_model(cameras: Sequence[Camera]) -> str:
    """Return the model that most tools look for at the top only: OPENCV, unless all lenses are fisheyes."""
    fisheyes = {camera.lens_model for camera in cameras} == {"fisheye"}
    return WRITTEN["fisheye" if fisheyes else "opencv"]


def _frame_table(camera: Camera, common: str) -> dict[str, object]:
    world_from_cam = camera.cam_from_rig.inverse().matrix
    world_from_cam[:3, :3] = world_from_cam[:3, :3] @ OPENCV_FROM_OPENGL
    places = {"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy}
    places |= dict(zip(NAMES[camera.lens_model], camera.distortion, strict=False))
    model = WRITTEN[camera.lens_model]
    return {
        "camera_id": camera.id,
        "w": camera.width,
        "h": camera.height,
        **({"camera_model": model} if model != common else {}),
        **{key: float(n) for key, n in places.items()},
        "transform_matrix": world_from_cam.tolist(),
    }
