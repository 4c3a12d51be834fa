"""The last look through a rig's cameras: one file, so that its pictures and figures are of the same moment.

It lies beside `look.png`, the picture of all cameras together.
"""

from __future__ import annotations

import io
import json
import os
import time
import zipfile
from pathlib import Path

from acquisition.durable import write_durably
from server.errors import NotFoundError
from server.schemas.pictures import CameraFigures

_FILE, _FIGURES = "look.zip", "figures.json"


def keep_look(folder: Path, figures: list[CameraFigures], pictures: dict[str, bytes]) -> None:
    """Write what the cameras of a rig saw, their PNGs by their ids, in place of the look before."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(_FIGURES, json.dumps([one.model_dump() for one in figures]))
        for camera_id, png in pictures.items():
            archive.writestr(f"{camera_id}.png", png)
    write_durably(folder / _FILE, buffer.getvalue())


class KeptLook:
    """A look as it was kept; raises FileNotFoundError where there is none."""

    def __init__(self, folder: Path) -> None:
        with (folder / _FILE).open("rb") as file, zipfile.ZipFile(file) as archive:
            self.figures = [CameraFigures.model_validate(one) for one in json.loads(archive.read(_FIGURES))]
            self._pictures = {one.id: archive.read(f"{one.id}.png") for one in self.figures}
            self.age_s = max(0.0, time.time() - os.fstat(file.fileno()).st_mtime)

    def picture(self, camera_id: str) -> bytes:
        """Return the PNG of one camera; raises NotFoundError."""
        if camera_id not in self._pictures:
            raise NotFoundError(f"found no camera {camera_id[:60]}", f"one of {', '.join(self._pictures)}")
        return self._pictures[camera_id]

    @property
    def digested(self) -> bytes:
        """The bytes whose digest tells this look from others: its pictures."""
        return b"".join(self._pictures.values())
