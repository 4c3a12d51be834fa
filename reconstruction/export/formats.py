"""Every format by name, and how a file or folder of one comes to be: aside, then renamed, never half-written."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from types import MappingProxyType

from acquisition.durable import made_aside, write_json
from acquisition.progress import Progress, silent
from reconstruction.errors import BadRunError
from reconstruction.export.colmap import write_colmap
from reconstruction.export.depth import write_depth
from reconstruction.export.glb import glb_bytes
from reconstruction.export.nerfstudio import write_nerfstudio
from reconstruction.export.ply import ply_bytes, write_ply_sequence
from reconstruction.export.scene import Choices, Scene, Splats, splats_at
from reconstruction.export.splat import splat_bytes
from reconstruction.export.spz import spz_bytes
from reconstruction.export.video import write_video
from reconstruction.export.viewer import export_viewer

MANIFEST = "manifest.json"
VERSION = 1
Writer = Callable[[Path, Scene, Choices, Progress], dict]


@dataclass(frozen=True)
class Format:
    """`write` makes what does not exist yet, a file or a folder, and returns what a folder's manifest adds.

    `takes`: the fields of `Choices` that mean something to it.
    """

    write: Writer
    folder: bool
    takes: frozenset[str]


def _splats(encode: Callable[[Splats], bytes]) -> Format:
    """A file of the Gaussians at one instant."""

    def write(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
        splats = splats_at(scene, scene.instant_s(choices))
        path.write_bytes(encode(splats))
        progress(1.0, f"{len(splats)} Gaussians")
        return {}

    return Format(write, folder=False, takes=frozenset({"at_s"}))


def _file(write: Writer, *takes: str) -> Format:
    return Format(write, folder=False, takes=frozenset(takes))


def _folder(write: Writer, *takes: str) -> Format:
    return Format(write, folder=True, takes=frozenset(takes))


FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        "ply": _splats(ply_bytes),
        "ply-sequence": _folder(write_ply_sequence, "frames"),
        "splat": _splats(splat_bytes),
        "spz": _splats(spz_bytes),
        "glb": _splats(glb_bytes),
        "video": _file(write_video, "frames", "camera"),
        "depth": _folder(write_depth, "frames", "camera"),
        "colmap": _folder(write_colmap, "at_s"),
        "nerfstudio": _folder(write_nerfstudio, "at_s", "frames"),
        "viewer": _folder(export_viewer),
    }
)
OPTIONS = {"at_s": "--at", "frames": "--frames", "camera": "--camera"}


def checked_format(name: str, choices: Choices) -> Format:
    """The format called `name`; raises BadRunError for an unknown one, or for choices it has no use for."""
    if name not in FORMATS:
        raise BadRunError(f"found the format {name!r}", f"one of {', '.join(FORMATS)}")
    if choices.frames is not None and choices.frames < 1:
        raise BadRunError(f"found {choices.frames} frames", "one or more", "change --frames")
    found = FORMATS[name]
    for field in fields(choices):
        if getattr(choices, field.name) is not None and field.name not in found.takes:
            taken = ", ".join(OPTIONS[name] for name in OPTIONS if name in found.takes) or "neither"
            raise BadRunError(f"found {OPTIONS[field.name]} for {name}, which takes {taken}", do="leave it out")
    return found


def check_target(path: Path, *, folder: bool, overwrite: bool) -> None:
    """Raises BadRunError where `path` holds something that may not be replaced.

    Nothing is replaced unasked; a folder never, unless an export made it, as its manifest says.
    """
    if path.is_dir() and not folder:
        raise BadRunError("found a folder", "the name of a file", "change --out", where=path)
    if path.is_file() and folder:
        raise BadRunError("found a file", "the name of a folder", "change --out", where=path)
    if not (any(path.iterdir()) if path.is_dir() else path.exists()):
        return
    if not overwrite:
        raise BadRunError("found something there", "a new name", "change --out or add --overwrite", where=path)
    if folder and _made_by(path) not in FORMATS:
        raise BadRunError("found a folder that no export made", "one to replace", "change --out", where=path)


def export_scene(
    scene: Scene,
    name: str,
    path: Path,
    choices: Choices | None = None,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> None:
    """Write `scene` in the format called `name` at `path`.

    Raises BadRunError for a format, choices or a path that cannot be used, RigError for an unknown camera.
    """
    chosen = choices or Choices()
    found = checked_format(name, chosen)
    check_target(path, folder=found.folder, overwrite=overwrite)
    scene.instant_s(chosen)
    scene.camera(chosen)
    with made_aside(path) as aside:
        extra = found.write(aside, scene, chosen, progress)
        if found.folder:
            clip = scene.cloud.clip
            manifest = {"version": VERSION, "format": name, "clip_s": [clip.first_s, clip.last_s], **extra}
            write_json(aside / MANIFEST, manifest)


def _made_by(folder: Path) -> str:
    """The format whose export made `folder`; empty where none did."""
    try:
        return str(json.loads((folder / MANIFEST).read_text())["format"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""
