"""Sources of a simulated camera's planes: a scene that is rendered a few planes ahead of the reader, or a recording."""

import math

import numpy as np
from numpy.typing import NDArray

from acquisition.errors import BadRecordingError
from acquisition.scenes.glass import Pane
from acquisition.scenes.own import AS_NOMINAL, Own
from acquisition.scenes.view import View, Visible
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from rigs.camera import Camera
from rigs.clock import RigClock

CHUNK = 32  # most planes rendered at a time
CHUNK_PX = 3_200_000  # most pixels of them: 13 MB of light for each camera
INSTANTS_HZ = 20000  # least rate at which a scene is rendered


class SceneSource:
    """The planes of one camera in one scene, `ticks` of them, each the light at the middle of its tick.

    A tick's light is that of one instant, not its integral: at 5 m/s and 120 rad/s and INSTANTS_HZ the two agree to
    64 dB. A longer tick has the mean of as many instants as it takes. The cameras of a rig run side by side, so by
    default each takes one of the cores; `threads` 0 takes every core. `own` is the gain and lag of the camera, `pane`
    what its light passes. Raises BadRecordingError when camera, sensor and layout differ in size.
    """

    def __init__(
        self,
        scene: Visible,
        camera: Camera,
        clock: RigClock,
        ticks: int,
        sensor: Sensor,
        layout: PlaneLayout,
        *,
        samples: int = 2,
        threads: int = 1,
        own: Own = AS_NOMINAL,
        pane: Pane | None = None,
    ):
        sizes = {(camera.height, camera.width), sensor.shape, (layout.height, layout.width)}
        if len(sizes) > 1:
            raise BadRecordingError(f"found camera, sensor and layout of the sizes {sizes}", "one", where=camera.id)
        self.layout = layout
        self.sensitivity = 1.0  # spikes for the same light, as a share of those at the nominal threshold
        self.own = own
        self._scene, self._camera, self._sensor, self._pane = scene, camera, sensor, pane
        self._clock, self._ticks = clock, ticks
        self._samples, self._threads = samples, threads
        self._view: View | None = None
        self._rendered = 0
        self._ready = np.empty((0, layout.plane_bytes), dtype=np.uint8)

    def next_planes(self, count: int) -> NDArray[np.uint8]:
        """Return the next packed planes [n, B]; n < count only where the clip ends."""
        ready = [self._ready]
        while sum(map(len, ready)) < count and self._rendered < self._ticks:
            ready.append(self._next_chunk())
        planes = np.concatenate(ready)
        self._ready = planes[count:]
        return planes[:count]

    def _next_chunk(self) -> NDArray[np.uint8]:
        if self._view is None:  # not in the constructor: nine cameras are built at once, and threads run them
            self._view = self._scene.view(self._camera, self._samples, self._threads)
        each = math.ceil(INSTANTS_HZ / self._clock.tick_rate_hz)
        chunk = min(CHUNK, CHUNK_PX // (self._camera.width * self._camera.height))
        last = min(self._rendered + max(1, chunk // each), self._ticks)
        parts = (np.arange(each) + 0.5) / each - 0.5 + self.own.lag_ticks
        instants_s = np.array([self._clock.instant_s(k + part) for k in range(self._rendered, last) for part in parts])
        light = self._view.light(instants_s)
        if each > 1:
            light = light.reshape(last - self._rendered, each, *light.shape[1:]).mean(axis=1)
        self._rendered = last
        light = self._pane.passed(light) if self._pane else light
        gain = self.sensitivity * self.own.gain
        light = light if gain == 1 else light * np.float32(gain)
        return pack(self._sensor.expose(light), self.layout)


class ReplaySource:
    """The planes of one recorded camera, in order, as they lie in its file."""

    def __init__(self, stream: SpikeStream):
        self.layout = stream.layout
        self._stream = stream
        self._given = 0

    def next_planes(self, count: int) -> NDArray[np.uint8]:
        """Return the next packed planes [n, B], n < count only where the recording ends."""
        last = min(self._given + count, len(self._stream))
        planes = self._stream.window(self._given, last)
        self._given = last
        return planes


Source = SceneSource | ReplaySource
