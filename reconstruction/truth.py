"""Reads `truth/` of a simulated recording."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquisition.arrays import read_array
from acquisition.scenes.own import OWN_FILE
from acquisition.spikes.stream import MOST_LIGHT
from reconstruction.errors import BadRunError
from rigs.exchange.cameras import load_cameras
from rigs.rig import Rig


@dataclass(frozen=True, eq=False)
class TruthFrame:
    """Linear intensity [H, W] in spikes per tick, depth [H, W] in m (NaN where nothing is), moving pixels [H, W].

    Intensity ends at MOST_LIGHT: no camera knows a lamp in a mirror better (decision 175). `ids` [H, W] are the
    objects'.
    """

    plane: int
    intensity: NDArray[np.float32]
    depth: NDArray[np.float32]
    moving: NDArray[np.bool_]
    ids: NDArray[np.integer]


@dataclass(frozen=True)
class Truth:
    """A truth folder; `white` is the data range of every metric, `movers` the object ids that move.

    `metre` is the length of a metre of the truth in the frame it is compared in, `gain` a light of 1 in units
    of that frame, and `lag_ticks` how much later it is there. `ticks` are those of the planes at hand, None for all:
    planes are numbered from the first of them on, files by tick. `blur_ticks` are those of a blurred image,
    `exposure_ticks` those of an ordinary camera's frame, 0 where there is none.
    """

    path: Path
    white: float
    movers: tuple[int, ...]
    metre: float = 1.0
    gain: float = 1.0
    lag_ticks: float = 0.0
    ticks: range | None = None
    blur_ticks: int = 1
    exposure_ticks: int = 0

    @classmethod
    def open(cls, path: Path) -> Truth:
        """Open a truth folder; raises BadRunError where `path` is none."""
        try:
            scene = json.loads((path / "scene.json").read_text())
            movers = tuple(int(m["id"]) for m in scene["movers"])
            blur, exposure = scene.get("blur", {}), scene.get("ordinary", {})
            means = {"blur_ticks": blur.get("window_ticks", 1), "exposure_ticks": exposure.get("exposure_ticks", 0)}
            return cls(path, float(scene["white"]), movers, **means)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise BadRunError("found no usable scene.json", "a simulated recording's truth", where=path) from error

    def within(self, ticks: range) -> Truth:
        """Return the truth of a recording, or a part of one, that has these ticks."""
        return replace(self, ticks=ticks)

    @property
    def _first_tick(self) -> int:
        return self.ticks.start if self.ticks else 0

    def knows(self, camera_id: str) -> bool:
        """Tell whether there is truth of a camera in any of the planes at hand."""
        return any(self.ticks is None or tick in self.ticks for tick in self._known(camera_id))

    def _known(self, camera_id: str) -> list[int]:
        return sorted(int(f.stem) for f in (self.path / camera_id).glob("[0-9]*.npy"))

    def planes(self, camera_id: str) -> list[int]:
        """Return the planes a camera has truth for; raises BadRunError where it has none."""
        ticks = self._known(camera_id)
        planes = [tick - self._first_tick for tick in ticks if self.ticks is None or tick in self.ticks]
        if not planes:
            found = f"found no truth of {camera_id}"
            expected = f"{camera_id}/000000.npy and so on"
            if ticks and self.ticks:
                found = f"found no truth of {camera_id} in ticks {self.ticks.start} to {self.ticks.stop}"
                expected = f"some as from {ticks[0]} to {ticks[-1]}"
            raise BadRunError(found, expected, where=self.path)
        return planes

    def frame(self, camera_id: str, plane: int) -> TruthFrame:
        """Return the truth of one camera at one plane; raises BadRunError where it cannot be read."""
        folder, tick = self.path / camera_id, plane + self._first_tick
        try:
            intensity, depth, ids = (read_array(folder / f"{kind}{tick:06d}.npy") for kind in ("", "depth_", "id_"))
        except (OSError, ValueError, EOFError) as error:
            raise BadRunError(f"found no readable truth at plane {tick}", "it whole", where=folder) from error
        intensity = np.minimum(intensity if self.gain == 1 else intensity * np.float32(self.gain), MOST_LIGHT)
        return TruthFrame(plane, intensity, depth * np.float32(self.metre), np.isin(ids, self.movers), ids)

    def blurred(self, camera_id: str, plane: int) -> NDArray[np.float32]:
        """Return the mean light [H, W] of the exposure centred on a plane, up to MOST_LIGHT.

        `scene.json` states its length.
        """
        return self._image(camera_id, "blur_", plane, "a blurred image at each plane of truth")

    def frame_planes(self, camera_id: str) -> list[int]:
        """Return the middle planes of an ordinary camera's exposures that lie whole in the planes at hand.

        Raises BadRunError where there are none.
        """
        ticks = sorted(int(f.stem.removeprefix("frame_")) for f in (self.path / camera_id).glob("frame_*.npy"))
        half, at_hand = self.exposure_ticks // 2, self.ticks or range(sys.maxsize)
        planes = [tick - self._first_tick for tick in ticks if tick - half in at_hand and tick + half in at_hand]
        if not planes:
            found = f"found no frame of an ordinary camera beside {camera_id}"
            do = "simulate it anew, and longer" if self.exposure_ticks else "simulate it anew"
            raise BadRunError(found, "frame_*.npy of a whole exposure", do, where=self.path)
        return planes

    def ordinary(self, camera_id: str, plane: int) -> NDArray[np.float32]:
        """Return what an ordinary camera reads [H, W] of the exposure around a plane, in spikes per tick."""
        return self._image(camera_id, "frame_", plane, "a frame of an ordinary camera")

    def _image(self, camera_id: str, prefix: str, plane: int, kind: str) -> NDArray[np.float32]:
        file = self.path / camera_id / f"{prefix}{plane + self._first_tick:06d}.npy"
        try:
            return np.minimum(read_array(file), MOST_LIGHT)
        except (OSError, ValueError, EOFError) as error:
            raise BadRunError("found no readable image", kind, where=file) from error

    def seen_by(self, views: Sequence[str]) -> Truth:
        """Return the truth as the cameras `views` have it on average: their geometric mean gain, and their mean lag.

        A scene that they alone have shown is in no other unit of light and on no other clock.
        """
        file = self.path / OWN_FILE
        own = json.loads(file.read_text()) if file.exists() else {}
        if not set(views) <= set(own):
            return self
        gain = float(np.exp(np.mean([np.log(own[view]["gain"]) for view in views])))
        white = self.white * gain
        return replace(
            self, white=white, gain=gain, lag_ticks=float(np.mean([own[view]["lag_ticks"] for view in views]))
        )

    def cameras(self, tick_rate_hz: float) -> Rig | None:
        """Return the true cameras; None in a truth that does not have them."""
        file = self.path / "cameras.json"
        return load_cameras(file, tick_rate_hz) if file.exists() else None


def spread(planes: list[int], count: int) -> list[int]:
    """Return at most `count` of the planes, evenly spread, the first and last included."""
    if len(planes) <= count:
        return planes
    return [planes[i] for i in np.linspace(0, len(planes) - 1, count).round().astype(int)]
