import numpy as np

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.images.catalogue import method
from reconstruction.images.replay import Replay


def stream_of(times, planes=200):
    spikes = np.zeros((planes, 1, 1), np.uint8)
    spikes[list(times)] = 1
    layout = PlaneLayout(1, 1)
    return SpikeStream(pack(spikes, layout), layout, 20000.0)


def played(replay):
    return [int(ticks[0, 0]) for closed, ticks in replay if closed[0, 0]]


def test_it_stops_at_the_first_spike_after_the_instant():
    replay = Replay(stream_of([80, 85, 92, 101, 104, 110]), 100)
    assert played(replay) == [5, 7, 9]
    assert replay.intervals[0, 0] == 3
    assert replay.silence[0, 0] == 0


def test_a_pixel_that_falls_silent_stays_open():
    replay = Replay(stream_of([80, 85]), 100)
    assert played(replay) == [5]
    assert replay.silence[0, 0] == 124 - 85
    assert replay.longest[0, 0] == 80 - 35  # the window begins at plane 36


def test_one_spike_bounds_the_light_by_the_longer_silence():
    for name in ("tfstp", "tvs"):
        estimate = method(name)(stream_of([102]), 100)
        assert not estimate.valid[0, 0]
        assert estimate.intensity[0, 0] < 1 / 64
