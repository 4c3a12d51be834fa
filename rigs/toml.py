"""Reads and writes rigs as TOML files, and lists the rigs that come with the package."""

import datetime
import importlib.resources
import re
import tomllib
from collections.abc import Iterable
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import cast

import tomli_w

from rigs.camera import Camera
from rigs.errors import RigError
from rigs.lens import LEAST_NUMBERS, NAMES, LensModel
from rigs.rig import Calibration, Poses, Rig
from rigs.tables import Fields
from rigs.transform import Transform

RIG_FIELDS = ("name", "tick_rate_hz", "poses", "calibration", "camera")
CALIBRATION_FIELDS = ("date", "residual_px", "rotation_sd_deg")
CAMERA_FIELDS = ("id", "serial", "width", "height", "fx", "fy", "cx", "cy")
CAMERA_FIELDS += ("lens_model", "distortion", "cam_from_rig", "pixels")
POSE_FIELDS = ("quat_wxyz", "translation_m")
GRID_ID = re.compile(r"cam(\d)(\d)")


def load_rig(path: Path) -> Rig:
    """Read a rig; raises RigError naming the file, the camera and the field that is missing, unknown or wrong."""
    try:
        with RigError.reading(path, "give an existing rig file"):
            text = path.read_bytes().decode()
    except UnicodeDecodeError as error:
        raise RigError("found bytes that are not UTF-8", "a rig in TOML", where=path) from error
    return parse_rig(text, str(path), path.parent)


def parse_rig(text: str, where: str, folder: Path | None) -> Rig:
    """Read a rig from TOML text; raises RigError as `load_rig` does, with `where` for the file.

    `folder` holds the rig's pixel calibrations; with None, a rig that names any is refused.
    """
    try:
        fields = Fields(tomllib.loads(text), where)
    except (ValueError, RecursionError) as error:  # also a number of too many digits
        raise RigError(f"found text that is not TOML ({error})", "a rig file", where=where) from error
    fields.refuse_others(RIG_FIELDS)
    cameras = tuple(_camera(entry, where, number, folder) for number, entry in enumerate(fields.list_at("camera")))
    calibration = _calibration(fields.table_at("calibration")) if "calibration" in fields.table else None
    name, rate_hz, poses = fields.word("name"), fields.number("tick_rate_hz"), fields.word("poses")
    with RigError.located(where):
        rig = Rig(name, rate_hz, cameras, cast(Poses, poses), calibration)
    refuse_holes(rig.ids, where)
    return rig


def dump_rig(rig: Rig) -> str:
    """Return the rig as TOML text; `load_rig` of it gives the same numbers back.

    Pixel calibrations are named as files that lie beside the text; whoever writes the text puts them there.
    """
    document: dict[str, object] = {"name": rig.name, "tick_rate_hz": float(rig.tick_rate_hz), "poses": rig.poses}
    if rig.calibration:
        document["calibration"] = {
            "date": rig.calibration.date,
            "residual_px": float(rig.calibration.residual_px),
            "rotation_sd_deg": float(rig.calibration.rotation_sd_deg),
        }
    document["camera"] = [_camera_table(camera) for camera in rig.cameras]
    return tomli_w.dumps(document)


def catalog_names() -> tuple[str, ...]:
    """List the names of the rigs that come with the package."""
    return tuple(sorted(f.name.removesuffix(".toml") for f in _catalog().iterdir() if f.name.endswith(".toml")))


def catalog_rig(name: str) -> Rig:
    """Return a rig that comes with the package; raises RigError listing the known names."""
    if name not in catalog_names():
        raise RigError(f"found no rig {name!r} in the catalog", f"one of {', '.join(catalog_names())}")
    return parse_rig((_catalog() / f"{name}.toml").read_text(encoding="utf-8"), f"{name}.toml", Path())


def refuse_holes(camera_ids: Iterable[str], where: str) -> None:
    """Raise RigError naming the cameras that are missing from the smallest grid that holds all `camRC` ids."""
    ids = set(camera_ids)
    cells = [(int(m[1]), int(m[2])) for m in map(GRID_ID.fullmatch, ids) if m]
    rows, columns = (1 + max((cell[axis] for cell in cells), default=-1) for axis in (0, 1))
    missing = [c for c in (f"cam{row}{column}" for row in range(rows) for column in range(columns)) if c not in ids]
    if missing:
        raise RigError(
            f"found {len(cells)} cameras of a {rows}x{columns} grid",
            f"also {', '.join(missing[:9])}",
            "add what is missing or name the cameras as a full grid",
            where=where,
        )


def _catalog() -> Traversable:
    return importlib.resources.files("rigs") / "catalog"


def _calibration(fields: Fields) -> Calibration:
    fields.refuse_others(CALIBRATION_FIELDS)
    date = fields.word("date")
    try:
        datetime.datetime.fromisoformat(date)
    except ValueError as error:
        raise RigError(f"found date = {date!r}", "an ISO date such as 2025-03-09", where=fields.where) from error
    return Calibration(date, fields.number("residual_px"), fields.number("rotation_sd_deg"))


def _camera(entry: object, where: str, number: int, folder: Path | None) -> Camera:
    fields = Fields(entry, f"{where}: {Fields(entry, f'{where}: camera {number}').word('id')}")
    fields.refuse_others(CAMERA_FIELDS)
    pose = fields.table_at("cam_from_rig")
    pose.refuse_others(POSE_FIELDS)
    width, height = fields.whole("width"), fields.whole("height")
    fx, fy, cx, cy = (fields.number(name) for name in ("fx", "fy", "cx", "cy"))
    model = cast(LensModel, fields.word("lens_model", "opencv"))
    distortion = tuple(fields.numbers("distortion", (_coefficients(fields, model),), (0.0,) * LEAST_NUMBERS).tolist())
    quat_wxyz, translation_m = pose.numbers("quat_wxyz", (4,)), pose.numbers("translation_m", (3,))
    extras = {"serial": fields.word("serial", ""), "pixels": _pixels(fields, folder)}
    with RigError.located(pose.where):
        cam_from_rig = Transform.from_quat_wxyz(quat_wxyz, translation_m)
    with RigError.located(where):
        lens = (width, height, fx, fy, cx, cy)
        return Camera(fields.word("id"), *lens, cam_from_rig, distortion=distortion, lens_model=model, **extras)


def _coefficients(fields: Fields, model: LensModel) -> int:
    """Return how many numbers the distortion must have: as many as it has where the lens allows that."""
    given = fields.table.get("distortion")
    most = len(NAMES.get(model, ()))
    return most if isinstance(given, list) and len(given) == most else LEAST_NUMBERS


def _pixels(fields: Fields, folder: Path | None) -> Path | None:
    name = fields.word("pixels", "")
    if not name:
        return None
    if folder is None:
        raise RigError(f"found pixels = {name!r:.80}", "a rig without files", "leave pixels out", where=fields.where)
    if Path(name).name != name or not (folder / name).is_file():
        raise RigError(f"found pixels = {name!r}", "a file of that name beside the rig file", where=fields.where)
    return folder / name


def _camera_table(camera: Camera) -> dict[str, object]:
    table: dict[str, object] = {name: getattr(camera, name) for name in ("id", "serial", "width", "height")}
    if camera.pixels:
        table["pixels"] = camera.pixels.name
    table |= {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    if camera.lens_model != "opencv":
        table["lens_model"] = camera.lens_model
    table["distortion"] = [float(k) for k in camera.distortion]
    table["cam_from_rig"] = {
        "quat_wxyz": camera.cam_from_rig.quat_wxyz.tolist(),
        "translation_m": camera.cam_from_rig.translation.tolist(),
    }
    return table
