"""Keeps the calibration that a job has found as a version of its rig's, and as the current one if that was asked."""

import json
from pathlib import Path

from acquisition.durable import write_durably
from rigs.rig import Rig
from rigs.toml import dump_rig, load_rig, parse_rig
from server.store.rig_files import fitted, with_pixels_of, without_pixels
from server.store.store import Store
from server.store.tables import Entry, Found, Source, StoredCalibration


def keep_calibration(store: Store, entry: Entry, out: Path) -> StoredCalibration | None:
    """Keep and return what a job has left in `out`, once however often it is done again; None where it names no rig.

    Poses come with the current pixel maps, pixel maps with the current poses. Raises NotFoundError,
    RigError, RigMismatchError and DiskError.
    """
    rig_id = entry.request.get("rig")
    if rig_id is None:
        return None
    rig = drawn_rig(store, rig_id)
    measured = store.rig_files.adopt_pixels(rig_id, fitted(load_rig(out / "rig.toml"), rig))
    said = json.loads((out / "result.json").read_text())
    report = {name: value for name, value in said.items() if name not in ("rig", "picture")}  # paths of this host
    picture = out / "rig-residuals.png"
    if picture.is_file():
        write_durably(store.rig_files.picture(rig_id, entry.id), picture.read_bytes())
    source: Source = "pixels" if entry.request.get("dark") else "board" if entry.request["board"] else "natural"

    def document(current: str | None) -> str:
        folder = store.folder.rig(rig_id)
        before = rig if current is None else fitted(parse_rig(current, "the current calibration", folder), rig)
        return dump_rig(with_pixels_of(before, measured) if source == "pixels" else with_pixels_of(measured, before))

    found = Found(source, report, entry.id)
    stored = store.calibrations.add(rig_id, found, document, apply=entry.request["apply"])
    store.rig_files.refresh(rig_id)
    return stored


def write_current(store: Store, rig_id: str, out: Path) -> Path:
    """Write a rig's current rig file into `out`, named by its version and without pixel maps; return its path."""
    current, stored = store.calibrations.current(rig_id)
    folder = store.folder.rig(rig_id)
    rig = parse_rig(stored.document, "the current calibration", folder) if stored else drawn_rig(store, rig_id)
    path = out / f"calibration-{current.version}.toml"
    write_durably(path, dump_rig(without_pixels(rig)))
    return path


def drawn_rig(store: Store, rig_id: str) -> Rig:
    """Return the rig as it was drawn; raises NotFoundError where the service has none of this name."""
    return load_rig(store.rig_files.drawn(rig_id))
