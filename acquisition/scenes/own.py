"""The gain and the lag that each camera of a rig has of its own: nine cameras are never set alike.

Exposures of real rigs differ by 5 to 20 %, and triggers reach sensors a part of a tick to some ticks apart.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acquisition.arrays import write_array
from acquisition.durable import write_json
from acquisition.spikes.sensor import Sensor

OWN_FILE = "own.json"  # gain and lag of each camera in a truth folder


class Own(NamedTuple):
    """The spikes of a camera for the same light, as a share of the nominal, and the ticks by which it sees later."""

    gain: float = 1.0
    lag_ticks: float = 0.0


AS_NOMINAL = Own()
LEAST_GAIN = 0.1  # of a camera that is drawn far below the nominal


def owned(cameras: int, gains: float, lags: float, seed: int) -> list[Own]:
    """Draw gains with the standard deviation `gains` about 1, and lags evenly within `lags` ticks, for so many cameras.

    One does not change the other: both are drawn, then scaled.
    """
    rng = np.random.default_rng([seed, 0x0E])
    drawn = zip(rng.standard_normal(cameras), rng.uniform(-1, 1, cameras), strict=True)
    return [Own(max(LEAST_GAIN, 1 + gains * float(gain)), lags * float(lag)) for gain, lag in drawn]


def write_own(folder: Path, own: Mapping[str, Own], sensors: Mapping[str, Sensor]) -> None:
    """Write beside the truth in `folder` what each camera and each of its pixels has of its own.

    `own.json` has gains and lags by camera id. `camRC/pixel_gain.npy` and `pixel_dark.npy` (float32 [H, W], the dark in
    spikes per tick) say how pixels begin, `pixel_fails.npy` (int64 [H, W]) the tick at which one fails, -1 for never.
    """
    write_json(folder / OWN_FILE, {camera: values._asdict() for camera, values in own.items()})
    for camera, sensor in sensors.items():
        gain, dark = sensor.response
        fails = np.full(sensor.shape, -1, dtype=np.int64)
        fails.flat[sensor.failures.pixels] = sensor.failures.ticks
        for name, values in (("gain", gain), ("dark", dark), ("fails", fails)):
            write_array(folder / camera / f"pixel_{name}.npy", values)
