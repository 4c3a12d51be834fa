"""Reads `truth/` of a simulated recording."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.errors import BadRunError
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig


@dataclass(frozen=True, eq=False)
class TruthFrame:
    """Linear intensity [H, W] in spikes per tick, depth [H, W] in m (NaN where nothing is), moving pixels [H, W]."""

    plane: int
    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]
    moving: NDArray[np.bool_]


@dataclass(frozen=True)
class Truth:
    """A truth folder; `white` is the data range of every metric, `movers` the object ids that move.

    `metre` is the length of a metre of the truth in the frame it is compared in.
    """

    path: Path
    white: float
    movers: tuple[int, ...]
    metre: float = 1.0

    @classmethod
    def open(cls, path: Path) -> Truth:
        """Open a truth folder; raises BadRunError where `path` is none."""
        try:
            scene = json.loads((path / "scene.json").read_text())
            return cls(path, float(scene["white"]), tuple(int(m["id"]) for m in scene["movers"]))
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BadRunError("found no usable scene.json", "a simulated recording's truth", where=path) from error

    def planes(self, camera_id: str) -> list[int]:
        """Return the planes a camera has truth for; raises BadRunError where it has none."""
        planes = sorted(int(f.stem) for f in (self.path / camera_id).glob("[0-9]*.npy"))
        if not planes:
            raise BadRunError(f"found no truth of {camera_id}", f"{camera_id}/000000.npy and so on", where=self.path)
        return planes

    def frame(self, camera_id: str, plane: int) -> TruthFrame:
        """Return the truth of one camera at one plane; raises BadRunError where it cannot be read."""
        folder = self.path / camera_id
        try:
            intensity, depth, ids = (np.load(folder / f"{kind}{plane:06d}.npy") for kind in ("", "depth_", "id_"))
        except (OSError, ValueError, EOFError) as error:
            raise BadRunError(f"found no readable truth at plane {plane}", "it whole", where=folder) from error
        return TruthFrame(plane, intensity, depth * np.float32(self.metre), np.isin(ids, self.movers))

    def blurred(self, camera_id: str, plane: int) -> NDArray[np.float32]:
        """Return the mean light [H, W] of the exposure centred on a plane, whose length `scene.json` states."""
        file = self.path / camera_id / f"blur_{plane:06d}.npy"
        try:
            return np.load(file)
        except (OSError, ValueError, EOFError) as error:
            raise BadRunError("found no readable blurred image", "one at each plane of truth", where=file) from error

    def cameras(self, tick_rate_hz: float) -> Rig | None:
        """Return the true cameras; None in a truth that does not have them."""
        file = self.path / "cameras.json"
        return load_cameras(file, tick_rate_hz) if file.exists() else None


def spread(planes: list[int], count: int) -> list[int]:
    """Return at most `count` of the planes, evenly spread, the first and last included."""
    if len(planes) <= count:
        return planes
    return [planes[i] for i in np.linspace(0, len(planes) - 1, count).round().astype(int)]
