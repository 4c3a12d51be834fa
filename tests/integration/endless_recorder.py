"""Records three endless cameras until it is killed: OUT RATE_BLOCKS_PER_S TAKEN.

TAKEN is a file of u64: how many planes each camera's ring took. What found it full is not counted.
"""

import sys
import time
from pathlib import Path

import numpy as np
from maintenance.plain_camera import PlainCamera

from acquisition.devices.protocol import Block
from acquisition.recording.stream_writer import StreamWriter
from acquisition.recording.writer import DiskUse, RecordingWriter
from acquisition.session.session import record_session
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(400, 250)
BLOCK_PLANES, CAMERAS, RATE_HZ = 8, 3, 20_000.0
RING_BYTES = 4 << 20


class Endless(PlainCamera):
    """Plane k of camera c is full of the byte 1 + (k * 7 + c * 31) % 255; every 50th block is lost on the way."""

    layout = LAYOUT

    def __init__(self, number: int, pause_s: float):
        super().__init__()
        self.id = f"cam0{number}"
        self.number, self.pause_s = number, pause_s
        self.block = 0

    def ensure_ready(self) -> None: ...

    def ensure_stopped(self) -> None: ...

    def read_block(self, timeout_s: float) -> Block:
        time.sleep(self.pause_s)
        self.block += 2 if self.block % 50 == 49 else 1
        first = (self.block - 1) * BLOCK_PLANES
        values = 1 + (np.arange(first, first + BLOCK_PLANES) * 7 + self.number * 31) % 255
        packed = np.repeat(values.astype(np.uint8)[:, None], LAYOUT.plane_bytes, axis=1)
        return Block(self.block, first, 0, LAYOUT, packed)


class Pulse:
    kind = "line"
    period_s = None

    def fire(self) -> None: ...


class CountingWriter(RecordingWriter):
    """Counts in `taken` the planes that each stream took."""

    taken: np.ndarray

    def stream(self, camera_id: str, layout: PlaneLayout, planes: int | None = None) -> StreamWriter:
        stream = super().stream(camera_id, layout, planes)
        offer, number = stream.offer, int(camera_id[-1])

        def counted(packed: np.ndarray) -> bool:
            took = offer(packed)
            self.taken[number] += len(packed) if took else 0
            return took

        stream.offer = counted
        return stream


def main(out: str, blocks_per_s: str, taken: str) -> None:
    cameras = [Endless(n, 1 / float(blocks_per_s)) for n in range(CAMERAS)]
    rig = Rig("x", RATE_HZ, tuple(Camera(c.id, 400, 250, 450, 450, 200, 125, Transform.identity()) for c in cameras))
    with CountingWriter(Path(out), rig, DiskUse(ring_bytes=RING_BYTES)) as recording:
        recording.taken = np.memmap(taken, dtype=np.uint64, mode="r+", shape=(CAMERAS,))
        record_session(cameras, Pulse(), None, recording)


if __name__ == "__main__":
    main(*sys.argv[1:])
