import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.spikes import packing
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream

LAYOUT = PlaneLayout(13, 7)
PLANES = (np.random.default_rng(1).random((30, 7, 13)) < 0.4).astype(np.uint8)


@pytest.fixture
def dat(tmp_path):
    path = tmp_path / "cam00.dat"
    path.write_bytes(pack(PLANES, LAYOUT).tobytes())
    return path


def test_windows_of_a_stream(dat):
    stream = SpikeStream.open(dat, LAYOUT, 20000)
    assert (len(stream), stream.tick_rate_hz, stream.partial_bytes) == (30, 20000, 0)
    for first, last in ((0, 30), (0, 0), (7, 8), (29, 30), (30, 30)):
        np.testing.assert_array_equal(stream.planes(first, last), PLANES[first:last])
        np.testing.assert_array_equal(stream.counts(first, last), PLANES[first:last].sum(axis=0))
    assert isinstance(stream.packed, np.memmap)


@pytest.mark.parametrize("window", [(-1, 3), (0, 31), (5, 4), (31, 31)])
def test_a_window_outside_the_stream_is_refused(dat, window):
    stream = SpikeStream.open(dat, LAYOUT, 20000)
    for read in (stream.window, stream.planes, stream.counts):
        with pytest.raises(BadRecordingError, match=f"{window[0]}:{window[1]}.*0:30"):
            read(*window)


def test_a_truncated_file_is_refused_or_cut_on_request(dat):
    dat.write_bytes(dat.read_bytes()[:-5])
    with pytest.raises(BadRecordingError, match=r"cam00\.dat: found 355 bytes, 7 more than 29 whole planes"):
        SpikeStream.open(dat, LAYOUT, 20000)
    stream = SpikeStream.open(dat, LAYOUT, 20000, allow_partial=True)
    assert (len(stream), stream.partial_bytes) == (29, 7)
    np.testing.assert_array_equal(stream.planes(0, 29), PLANES[:29])


@pytest.mark.parametrize("size", [0, 11])
def test_a_file_without_a_whole_plane_is_refused_even_when_partial_is_allowed(dat, size):
    dat.write_bytes(bytes(size))
    with pytest.raises(BadRecordingError, match=rf"cam00\.dat: found {size} bytes, expected at least one plane"):
        SpikeStream.open(dat, LAYOUT, 20000, allow_partial=True)


@pytest.mark.parametrize("name", ["cam00.compact", "cam00.dat"])
def test_a_compact_file_is_not_taken_for_planes(tmp_path, name):
    (tmp_path / "cam00.compact").write_bytes(bytes(12))
    with pytest.raises(BadRecordingError, match=rf"{name}: found it compact, expected a .dat; name its recording, or"):
        SpikeStream.open(tmp_path / name, LAYOUT, 20000)


def test_what_cannot_be_read_is_refused(tmp_path, dat):
    with pytest.raises(BadRecordingError, match=r"none\.dat"):
        SpikeStream.open(tmp_path / "none.dat", LAYOUT, 20000)
    with pytest.raises(BadRecordingError, match=tmp_path.name):
        SpikeStream.open(tmp_path, PlaneLayout(8, 1), 20000)
    for rate in (0, -1, float("nan")):
        with pytest.raises(BadRecordingError, match="tick rate"):
            SpikeStream.open(dat, LAYOUT, rate)


@pytest.mark.parametrize("piece_planes", [1, 7, 64, 10_000])
def test_a_long_file_is_counted_in_pieces_and_read_again_after_it_was_let_go(tmp_path, monkeypatch, piece_planes):
    planes = (np.random.default_rng(3).random((150, 10, 16)) < 0.3).astype(np.uint8)
    (tmp_path / "cam00.dat").write_bytes(pack(planes, PlaneLayout(16, 10)).tobytes())
    stream = SpikeStream.open(tmp_path / "cam00.dat", PlaneLayout(16, 10), 20_000.0)
    monkeypatch.setattr(packing, "PIECE_BYTES", piece_planes * stream.layout.plane_bytes)
    windows = [(0, 150), (0, 0), (3, 4), (63, 65), (100, 150), (140, 141), (0, 150)]
    expected = [planes[first:last].sum(axis=0) for first, last in windows]
    for part, shift in ((stream, 0), (stream.part(3, 150), 3)):
        own = [(first - shift, last - shift) for first, last in windows if first >= shift]
        kept = [counts for (first, _), counts in zip(windows, expected, strict=True) if first >= shift]
        np.testing.assert_array_equal(part.window_counts(own), kept)
        part.let_go()
        np.testing.assert_array_equal(part.planes(0, 5), planes[shift : shift + 5])


def test_planes_in_memory_have_nothing_to_let_go():
    planes = np.ones((4, 2, 8), np.uint8)
    stream = SpikeStream(pack(planes, PlaneLayout(8, 2)), PlaneLayout(8, 2), 20_000.0)
    stream.let_go()
    np.testing.assert_array_equal(stream.counts(0, 4), planes.sum(axis=0))
