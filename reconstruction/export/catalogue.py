"""Every export format by its name, and the writing of one: aside, then renamed, so that nothing is half-written.

A new format is one file of `reconstruction.export.formats` and a line in the README; every list follows. Listing
imports neither torch nor OpenCV.
"""

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

from acquisition.durable import made_aside, write_json
from acquisition.members import members
from acquisition.progress import Progress, silent
from reconstruction.errors import BadRunError
from reconstruction.export.scene import Choices, Format, Scene

MANIFEST = "manifest.json"
VERSION = 1
FORMATS: Mapping[str, Format] = members("reconstruction.export.formats", Format)
OPTIONS = {"at_s": "--at", "frames": "--frames", "camera": "--camera"}
OPTIONS |= {"from_tick": "--from-tick", "to_tick": "--to-tick"}


def checked_format(name: str, choices: Choices) -> Format:
    """Return the format called `name`; raises BadRunError for an unknown one, or for choices that it does not take."""
    if name not in FORMATS:
        raise BadRunError(f"found the format {name!r}", f"one of {', '.join(FORMATS)}")
    if choices.frames is not None and choices.frames < 1:
        raise BadRunError(f"found {choices.frames} frames", "one or more", "change --frames")
    found = FORMATS[name]
    for field in fields(choices):
        if getattr(choices, field.name) is not None and field.name not in found.takes:
            taken = ", ".join(OPTIONS[name] for name in OPTIONS if name in found.takes)
            raise BadRunError(f"found {OPTIONS[field.name]} for {name}, which takes {taken}", do="leave it out")
    return found


def check_target(path: Path, *, folder: bool, overwrite: bool) -> None:
    """Raise BadRunError where `path` holds something that may not be replaced.

    Nothing is replaced without `overwrite`, and of folders only those that an export made, as their manifest says.
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
    scene: Scene, name: str, path: Path, choices: Choices, *, overwrite: bool = False, progress: Progress = silent
) -> None:
    """Write `scene` in the format called `name` at `path`.

    Raises BadRunError for a format, choices or a path that cannot be used, RigError for an unknown camera,
    BadRecordingError for ticks that the scene does not cover.
    """
    found = checked_format(name, choices)
    check_target(path, folder=found.folder, overwrite=overwrite)
    scene = scene.chosen(choices)
    scene.instant_s(choices)
    scene.camera(choices)
    with made_aside(path) as aside:
        extra = found.write(aside, scene, choices, progress)
        if found.folder:
            clip = scene.clip
            manifest = {"version": VERSION, "format": name, "clip_s": [clip.first_s, clip.last_s], **extra}
            write_json(aside / MANIFEST, manifest)


def _made_by(folder: Path) -> str:
    """Return the format whose export made `folder`, or an empty string where none did."""
    try:
        return str(json.loads((folder / MANIFEST).read_text())["format"])
    except (OSError, ValueError, KeyError, TypeError):
        return ""
