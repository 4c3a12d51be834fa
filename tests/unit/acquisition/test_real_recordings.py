"""Recordings nobody here made decode to what their owners measured on them."""

import numpy as np
import pytest

from acquisition.spikes.compact import decode, encode
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import counts, pack, unpack
from acquisition.spikes.stream import SpikeStream

LAYOUT = PlaneLayout(400, 250)


@pytest.fixture(scope="module")
def car(spikedata) -> SpikeStream:
    return SpikeStream.open(spikedata / "histsflow_car.dat", LAYOUT, 20000)


def test_car_rate(car):
    planes = car.planes(0, len(car))
    assert planes.shape == (200, 250, 400)
    assert planes.mean() == pytest.approx(0.366, abs=0.001)
    np.testing.assert_array_equal(car.counts(0, 200), planes.sum(axis=0))


def test_car_packs_again_byte_for_byte(car):
    assert pack(car.planes(0, 200), LAYOUT).tobytes() == car.packed.tobytes()


def test_car_bit_order_shows_at_byte_boundaries(car):
    def steps(bit_order: str) -> tuple[float, float]:
        packed = car.window(84, 116)
        step = np.abs(np.diff(counts(packed, PlaneLayout(400, 250, bit_order)) / 32, axis=1)).mean(axis=0)
        across = np.arange(399) % 8 == 7
        return float(step[across].mean()), float(step[~across].mean())

    assert steps("lsb") == pytest.approx((0.0159, 0.0162), abs=0.0003)
    assert steps("msb") == pytest.approx((0.0769, 0.0162), abs=0.0003)


def test_car_stands_upright(car):
    """Block means tell every flip and turn apart: a bright car in the middle, a dark road at the lower left."""
    mean = car.counts(84, 117) / 33
    blocks = mean.reshape(5, 50, 5, 80).mean(axis=(1, 3))
    found = [blocks[0, 0], blocks[0, 4], blocks[4, 0], blocks[4, 4], blocks[2, 2]]
    assert found == pytest.approx([0.1993, 0.213, 0.0719, 0.2491, 0.3864], rel=0.03)  # measured: 2% in the dark block


def test_car_is_sub_poisson(car):
    blocks = car.planes(0, 200).reshape(10, 20, 250, 400).sum(axis=1, dtype=np.float64)
    lit = blocks.mean(axis=0) > 0
    fano = np.median(blocks.var(axis=0, ddof=1)[lit] / blocks.mean(axis=0)[lit])
    assert fano < 0.2


def test_dim_real_recording_round_trips(spikedata):
    with np.load(spikedata / "zoo_uhsr.npz") as archive:
        planes = archive["spk"]
    layout = PlaneLayout(250, 250)  # 62500 pixels: planes end inside a byte
    assert planes.mean() == pytest.approx(0.031, abs=0.0005)
    packed = pack(planes, layout)
    np.testing.assert_array_equal(unpack(packed, layout), planes != 0)
    np.testing.assert_array_equal(counts(packed, layout), (planes != 0).sum(axis=0))


def test_synthetic_recording_looks_like_its_picture(spikedata):
    cv2 = pytest.importorskip("cv2", reason="reads the PNG with OpenCV", exc_type=ImportError)
    stream = SpikeStream.open(spikedata / "zoo_data_200_part1.dat", LAYOUT, 20000)
    assert len(stream) == 301
    assert stream.counts(0, 301).mean() / 301 == pytest.approx(0.288, abs=0.001)
    picture = cv2.imread(str(spikedata / "zoo_data_200_part1_gt.png"), cv2.IMREAD_GRAYSCALE).astype(float)
    mean = stream.counts(130, 171) / 41

    def likeness(image) -> float:
        return float(np.corrcoef(image.ravel(), picture.ravel())[0, 1])

    flipped = max(likeness(mean[::-1]), likeness(mean[:, ::-1]), likeness(mean[::-1, ::-1]))
    assert likeness(mean) > max(0.9, flipped + 0.2)


def test_real_planes_are_a_third_as_compact_blocks_and_come_back(car):
    planes = car.window(0, 200)
    block = encode(planes)
    assert planes.nbytes / len(block) == pytest.approx(3.04, abs=0.05)
    np.testing.assert_array_equal(decode(block, *planes.shape), planes)
