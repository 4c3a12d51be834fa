"""Reads and writes COLMAP model folders, as text or binary; image names are camera ids (camRC or camRC.png)."""

import math
import struct
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.lens import LEAST_NUMBERS, LensModel, shortened
from rigs.transform import Transform


class Model(NamedTuple):
    """A camera model: its number in binary files, and the places in its `size` parameters of fx fy cx cy and a `lens`.

    A coefficient without a place (None) is zero; a parameter that has none here must be.
    """

    number: int
    size: int
    places: tuple[int, ...]
    coefficients: tuple[int | None, ...]
    lens: LensModel = "opencv"


ONE_FOCAL, TWO_FOCALS = (0, 0, 1, 2), (0, 1, 2, 3)
MODELS = {
    "SIMPLE_PINHOLE": Model(0, 3, ONE_FOCAL, (None, None, None, None)),
    "PINHOLE": Model(1, 4, TWO_FOCALS, (None, None, None, None)),
    "SIMPLE_RADIAL": Model(2, 4, ONE_FOCAL, (3, None, None, None)),
    "RADIAL": Model(3, 5, ONE_FOCAL, (3, 4, None, None)),
    "OPENCV": Model(4, 8, TWO_FOCALS, (4, 5, 6, 7)),
    "OPENCV_FISHEYE": Model(5, 8, TWO_FOCALS, (4, 5, 6, 7), "fisheye"),
    "FULL_OPENCV": Model(6, 12, TWO_FOCALS, (4, 5, 6, 7, 8)),  # k4 k5 k6, of a rational lens, must be zero
    "SIMPLE_RADIAL_FISHEYE": Model(8, 4, ONE_FOCAL, (3, None, None, None), "fisheye"),
    "RADIAL_FISHEYE": Model(9, 5, ONE_FOCAL, (3, 4, None, None), "fisheye"),
}
NUMBERED_MODELS = {model.number: name for name, model in MODELS.items()}

Lens = tuple[str, int, int, tuple[float, ...]]  # model, width, height, parameters
Pose = tuple[str, int, tuple[float, ...]]  # image name, camera number, qw qx qy qz tx ty tz
Parsed = TypeVar("Parsed")


def load_model(folder: Path) -> tuple[Camera, ...]:
    """Read the cameras of a COLMAP model, one an image, by image number; the model's world becomes the rig frame.

    Reads `.bin` where it is there, else `.txt`. Raises RigError naming the file or the camera.
    """
    suffix = ".bin" if (folder / "cameras.bin").exists() else ".txt"
    cameras_file, images_file = folder / f"cameras{suffix}", folder / f"images{suffix}"
    read_lenses, read_poses = (_binary_lenses, _binary_poses) if suffix == ".bin" else (_text_lenses, _text_poses)
    lenses = _read(cameras_file, read_lenses)
    poses = _read(images_file, read_poses)
    if not poses:
        raise RigError("found no images", "one a camera", where=images_file)
    return tuple(_camera(poses[number], lenses, folder) for number in sorted(poses))


def dump_model(cameras: Sequence[Camera]) -> dict[str, str]:
    """Return the text files of a COLMAP model by file name: cameras.txt, images.txt and an empty points3D.txt."""
    lenses, images = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS"], ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"]
    for number, camera in enumerate(cameras, start=1):
        model, parameters = _parameters(camera)
        lenses.append(f"{number} {model} {camera.width} {camera.height} {_digits(parameters)}")
        pose = (*camera.cam_from_rig.quat_wxyz, *camera.cam_from_rig.translation)
        images += [f"{number} {_digits(pose)} {number} {camera.id}.png", ""]
    return {"cameras.txt": "\n".join(lenses) + "\n", "images.txt": "\n".join(images) + "\n", "points3D.txt": ""}


def _parameters(camera: Camera) -> tuple[str, tuple[float, ...]]:
    """Return the smallest model that holds a camera's lens, and its parameters."""
    places, k = (camera.fx, camera.fy, camera.cx, camera.cy), camera.distortion
    if camera.lens_model == "fisheye":
        return "OPENCV_FISHEYE", (*places, *k)
    if any(k[LEAST_NUMBERS:]):
        return "FULL_OPENCV", (*places, *k, 0.0, 0.0, 0.0)
    return ("OPENCV", (*places, *k[:LEAST_NUMBERS])) if camera.bends else ("PINHOLE", places)


def dump_points(points: NDArray[np.floating], greys: NDArray[np.uint8]) -> str:
    """Return the text of a points3D.txt: points [N, 3] in metres with greys [N], no error known (-1), no tracks."""
    lines = ["# POINT3D_ID X Y Z R G B ERROR TRACK[]"]
    for number, (point, grey) in enumerate(zip(points.tolist(), greys.tolist(), strict=True), start=1):
        lines.append(f"{number} {_digits(point)} {grey} {grey} {grey} -1")
    return "\n".join(lines) + "\n"


def _read(path: Path, parse: Callable[[bytes], dict[int, Parsed]]) -> dict[int, Parsed]:
    with RigError.reading(path, "give the folder of a COLMAP model"):
        data = path.read_bytes()
    try:
        with RigError.located(path):
            return parse(data)
    except (ValueError, IndexError, OverflowError, struct.error) as error:
        raise RigError(f"found contents that do not parse ({error})", f"COLMAP's {path.name}", where=path) from error


def _camera(pose: Pose, lenses: dict[int, Lens], folder: Path) -> Camera:
    name, lens_number, numbers = pose
    path = PurePosixPath(name)
    camera_id = path.stem if path.suffix.lower() in (".png", ".jpg", ".jpeg", ".npy") else path.name
    where = f"{folder}: {camera_id}"
    if lens_number not in lenses:
        raise RigError(f"found no camera {lens_number}", f"one of {', '.join(map(str, lenses))}", where=where)
    model, width, height, parameters = lenses[lens_number]
    known = MODELS[model]
    fx, fy, cx, cy = (parameters[at] for at in known.places)
    distortion = shortened(tuple(0.0 if at is None else parameters[at] for at in known.coefficients))
    used = {*known.places, *known.coefficients}
    if any(value for at, value in enumerate(parameters) if at not in used):
        raise RigError("found k4, k5 or k6 of a FULL_OPENCV lens", "zeros", "undistort the pictures", where=where)
    if not all(map(math.isfinite, numbers)):
        raise RigError("found a pose with NaN or infinity", "finite numbers", "mend the pose", where=where)
    with RigError.located(where):
        cam_from_rig = Transform.from_quat_wxyz(numbers[:4], numbers[4:])
    with RigError.located(folder):
        lens = {"distortion": distortion, "lens_model": known.lens}
        return Camera(camera_id, width, height, fx, fy, cx, cy, cam_from_rig, **lens)


def _lens(model: str | int, width: int, height: int, parameters: Sequence[float]) -> Lens:
    if model not in MODELS:
        raise RigError(f"found the camera model {model}", f"one of {', '.join(MODELS)}", "undistort the pictures")
    if len(parameters) != MODELS[model].size:
        raise RigError(f"found {len(parameters)} parameters of {model}", str(MODELS[model].size))
    return model, width, height, tuple(parameters)


def _text_lenses(data: bytes) -> dict[int, Lens]:
    lenses = {}
    for line in data.decode().splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            lenses[int(words[0])] = _lens(words[1], int(words[2]), int(words[3]), [float(w) for w in words[4:]])
    return lenses


def _text_poses(data: bytes) -> dict[int, Pose]:
    poses = {}
    lines = iter(data.decode().splitlines())
    for line in lines:
        words = line.split(maxsplit=9)
        if not words or words[0].startswith("#"):
            continue
        poses[int(words[0])] = (words[9].strip(), int(words[8]), tuple(float(w) for w in words[1:8]))
        next(lines, None)  # the image's 2D points, an empty line where there are none
    return poses


def _binary_lenses(data: bytes) -> dict[int, Lens]:
    (count,), at, lenses = struct.unpack_from("<Q", data), 8, {}
    for _ in range(count):
        number, model_number, width, height = struct.unpack_from("<IiQQ", data, at)
        model = NUMBERED_MODELS.get(model_number, "")
        if not model:
            raise RigError(f"found the camera model number {model_number}", f"one of {', '.join(MODELS)}")
        parameters = struct.unpack_from(f"<{MODELS[model].size}d", data, at + 24)
        lenses[number] = _lens(model, width, height, parameters)
        at += 24 + 8 * len(parameters)
    _refuse_other_length(data, at)
    return lenses


def _binary_poses(data: bytes) -> dict[int, Pose]:
    (count,), at, poses = struct.unpack_from("<Q", data), 8, {}
    for _ in range(count):
        number, *numbers, lens_number = struct.unpack_from("<I7dI", data, at)
        end = data.index(b"\0", at + 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        poses[number] = (data[at + 64 : end].decode(), lens_number, tuple(numbers))
        at = end + 9 + 24 * points  # a 2D point is two doubles and the number of its 3D point
    _refuse_other_length(data, at)
    return poses


def _refuse_other_length(data: bytes, expected: int) -> None:
    if len(data) != expected:
        raise RigError(f"found {len(data)} bytes", str(expected), "the file is cut short or no COLMAP model")


def _digits(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(n)) for n in numbers)
