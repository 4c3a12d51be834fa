import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from references.spikes import counts_reference

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import counts, pack, unpack, unpack_reference

ORDERS = [(bit, row) for bit in ("lsb", "msb") for row in ("bottom", "top")]


@st.composite
def planes_and_layouts(draw):
    width, height = draw(st.integers(1, 70)), draw(st.integers(1, 20))
    bit_order, row_order = draw(st.sampled_from(ORDERS))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    planes = rng.random((draw(st.integers(0, 5)), height, width)) < draw(st.sampled_from([0.0, 0.1, 0.5, 1.0]))
    return planes.astype(np.uint8), PlaneLayout(width, height, bit_order, row_order)


@given(planes_and_layouts())
def test_unpack_inverts_pack_for_any_size(case):
    planes, layout = case
    packed = pack(planes, layout)
    assert packed.shape == (len(planes), layout.plane_bytes)
    np.testing.assert_array_equal(unpack(packed, layout), planes)
    np.testing.assert_array_equal(unpack_reference(packed, layout), planes)
    np.testing.assert_array_equal(counts(packed, layout), planes.sum(axis=0))


@given(planes_and_layouts())
def test_padding_bits_are_zero(case):
    planes, layout = case
    assert np.bitwise_count(pack(planes, layout)).sum() == planes.sum()


def test_bits_and_rows_lie_where_the_layout_says():
    planes = np.array([[[1, 0, 0], [0, 1, 1]]])  # pixels 0 1 2 / 3 4 5, top row first
    stored = {
        ("lsb", "top"): 0b110001,
        ("lsb", "bottom"): 0b001110,
        ("msb", "top"): 0b10001100,
        ("msb", "bottom"): 0b01110000,
    }
    for (bit_order, row_order), byte in stored.items():
        assert pack(planes, PlaneLayout(3, 2, bit_order, row_order)).tolist() == [[byte]]


# 255 planes fill the bit-sliced counters of the native kernel once; 512 pixels are one of its blocks.
@pytest.mark.parametrize("planes", [0, 1, 2, 254, 255, 256, 257, 510, 511, 600])
@pytest.mark.parametrize(("width", "height"), [(1, 1), (3, 1), (8, 1), (13, 7), (64, 8), (64, 9), (100, 64), (511, 3)])
@pytest.mark.parametrize(("bit_order", "row_order"), ORDERS)
def test_native_kernels_equal_the_reference(planes, width, height, bit_order, row_order):
    layout = PlaneLayout(width, height, bit_order, row_order)
    packed = np.random.default_rng(planes).integers(0, 256, (planes, layout.plane_bytes), dtype=np.uint8)
    found = counts(packed, layout)
    assert found.dtype == np.uint32
    np.testing.assert_array_equal(found, counts_reference(packed, layout))
    np.testing.assert_array_equal(unpack(packed[:20], layout), unpack_reference(packed[:20], layout))


@pytest.mark.parametrize("planes", [1, 255, 256, 600])
@pytest.mark.parametrize("spike", [0, 1])
def test_all_dark_and_all_bright(planes, spike):
    layout = PlaneLayout(13, 50)
    packed = pack(np.full((planes, 50, 13), spike), layout)
    np.testing.assert_array_equal(counts(packed, layout), spike * planes)
    assert (unpack(packed, layout) == spike).all()


def test_a_view_that_is_not_contiguous_is_read_right():
    layout = PlaneLayout(13, 7)
    packed = np.random.default_rng(0).integers(0, 256, (40, layout.plane_bytes), dtype=np.uint8)
    np.testing.assert_array_equal(unpack(packed[::3], layout), unpack_reference(packed[::3], layout))
    np.testing.assert_array_equal(counts(packed[::-1], layout), counts_reference(packed, layout))


def test_planes_of_another_size_are_refused():
    layout = PlaneLayout(13, 7)
    with pytest.raises(BadRecordingError, match=r"\(2, 7, 12\).*\(T, 7, 13\)"):
        pack(np.zeros((2, 7, 12)), layout)
    for packed in (np.zeros((2, 11), np.uint8), np.zeros((2, 12), np.int8), np.zeros(12, np.uint8)):
        for kernel in (unpack, counts):
            with pytest.raises(BadRecordingError, match="12"):
                kernel(packed, layout)


@pytest.mark.parametrize("changes", [{"width": 0}, {"height": -1}, {"bit_order": "middle"}, {"row_order": "left"}])
def test_a_layout_that_is_none_is_refused(changes):
    with pytest.raises(BadRecordingError, match=str(next(iter(changes.values())))):
        PlaneLayout(**({"width": 4, "height": 4} | changes))
