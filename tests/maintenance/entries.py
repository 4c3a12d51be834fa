"""Puts entries into the store of a service without a worker, and recordings behind its captures."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from rigs.rig import Rig
from rigs.toml import dump_rig
from server.services.services import Services
from server.store.tables import Entry


def added(services: Services, kind: Any, what: str, **fields: Any) -> str:
    """Add an entry, which is done where it has no queue, and return its id."""
    entries = services.store.entries
    entry = Entry(entries.dated_id(kind[0]), kind, what, entries.now(), fields.pop("request", {}), **fields)
    entries.add(entry)
    return entry.id


def imported(services: Services, rig: Rig, spikes: Iterable[NDArray[np.uint8]], folder: Path) -> str:
    """Return the id of a capture in which each camera has its `spikes` [T, H, W] of 0 and 1; files lie in `folder`."""
    for camera, planes in zip(rig.cameras, spikes, strict=True):
        layout = PlaneLayout(camera.width, camera.height)
        (folder / f"{camera.id}.dat").write_bytes(pack(planes, layout).tobytes())
    (folder / "rig.toml").write_text(dump_rig(rig))
    capture = added(services, "capture", "import")
    dats = [f"{camera_id}={folder / camera_id}.dat" for camera_id in rig.ids]
    import_recording(dats, folder / "rig.toml", services.store.folder.recording(capture), ImportOptions(20000))
    return capture
