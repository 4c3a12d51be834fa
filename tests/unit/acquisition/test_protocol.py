import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.devices.protocol import (
    LEADER,
    TRAILER,
    Block,
    BlockParser,
    Damage,
    Geometry,
    Identity,
    State,
    Status,
    decode_tick_rate,
    encode_block,
    encode_tick_rate,
)
from acquisition.errors import DeviceError
from acquisition.spikes.layout import PlaneLayout

layouts = st.builds(
    PlaneLayout,
    st.integers(1, 40),
    st.integers(1, 20),
    st.sampled_from(["lsb", "msb"]),
    st.sampled_from(["top", "bottom"]),
)


def make_block(layout: PlaneLayout, planes: int, block_id: int = 0, first_plane: int = 0, seed: int = 0) -> Block:
    packed = np.random.default_rng(seed).integers(0, 256, (planes, layout.plane_bytes), dtype=np.uint8)
    return Block(block_id, first_plane, first_plane * 50_000, layout, packed, 1, dropped_planes=3, status=1)


def three_blocks() -> tuple[list[Block], bytes]:
    layout = PlaneLayout(9, 5)
    blocks = [make_block(layout, 4, block_id=i, first_plane=4 * i, seed=i) for i in range(3)]
    return blocks, b"".join(map(encode_block, blocks))


def parse(data: bytes, cuts: list[int]) -> tuple[list[Block], list[Damage], BlockParser]:
    parser, blocks, damages = BlockParser(), [], []
    edges = [0, *sorted(cuts), len(data)]
    for first, last in itertools.pairwise(edges):
        parser.feed(data[first:last])
        while (found := parser.next()) is not None:
            (blocks if isinstance(found, Block) else damages).append(found)
    return blocks, damages, parser


def assert_same(found: Block, expected: Block) -> None:
    for name in ("block_id", "first_plane", "device_time_ns", "layout", "sync_pulses", "dropped_planes", "status"):
        assert getattr(found, name) == getattr(expected, name), name
    np.testing.assert_array_equal(found.packed, expected.packed)


def test_the_sizes_are_the_documented_ones():
    assert (LEADER.size, TRAILER.size) == (64, 32)


@given(layouts, st.integers(1, 5), st.lists(st.integers(0, 400), max_size=12), st.integers(0, 9))
def test_blocks_survive_any_cut_of_the_stream(layout, planes, cuts, seed):
    blocks = [make_block(layout, planes, i, i * planes, seed + i) for i in range(3)]
    data = b"".join(map(encode_block, blocks))
    found, damages, parser = parse(data, [c % len(data) for c in cuts])
    assert not damages
    assert parser.damages == 0
    for one, other in zip(found, blocks, strict=True):
        assert_same(one, other)


@settings(max_examples=300)
@given(st.data())
def test_a_flipped_bit_costs_its_block_and_no_other(data):
    blocks, stream = three_blocks()
    bit = data.draw(st.integers(0, 8 * len(stream) - 1))
    broken = bytearray(stream)
    broken[bit // 8] ^= 1 << bit % 8
    hurt = bit // 8 // (len(stream) // 3)
    found, damages, parser = parse(bytes(broken), [len(stream) // 2])
    assert parser.damages == 1
    assert len(damages) == (hurt < 2)  # the end of the last one is not known yet
    assert [b.block_id for b in found] == [i for i in range(3) if i != hurt]
    for block in found:
        assert_same(block, blocks[block.block_id])
    if damages:
        assert damages[0].skipped_bytes == len(stream) // 3


@settings(max_examples=200)
@given(st.data())
def test_lost_bytes_cost_no_block_that_follows(data):
    blocks, stream = three_blocks()
    size = len(stream) // 3
    first = data.draw(st.integers(0, size - 1))
    last = data.draw(st.integers(first + 1, size))
    found, _, _ = parse(stream[:first] + stream[last:], [])
    ids = [b.block_id for b in found]
    assert ids == [1, 2]
    assert_same(found[-1], blocks[2])


@given(st.binary(max_size=600))
def test_noise_before_a_block_is_reported_and_skipped(noise):
    blocks, stream = three_blocks()
    found, damages, _ = parse(noise + stream, [len(noise) // 2])
    assert [b.block_id for b in found] == [0, 1, 2]
    assert sum(d.skipped_bytes for d in damages) == len(noise)
    assert_same(found[0], blocks[0])


def test_a_payload_that_looks_like_a_leader_is_kept():
    layout = PlaneLayout(64, 8)
    packed = np.frombuffer((b"S4LD" * 16), dtype=np.uint8).reshape(1, 64)
    data = encode_block(Block(0, 0, 0, layout, packed))
    found, damages, _ = parse(data, [70, 90])
    assert not damages
    np.testing.assert_array_equal(found[0].packed, packed)


@given(layouts, st.integers(1, 1000))
def test_the_geometry_register_round_trips(layout, planes):
    assert Geometry.decode(Geometry(layout, planes).encode()) == Geometry(layout, planes)


def test_the_other_registers_round_trip():
    status = Status(State.ARMED, 3, 10**12, 7)
    assert Status.decode(status.encode()) == status
    assert Identity.decode(Identity(1, 4).encode()) == Identity(1, 4)
    assert decode_tick_rate(encode_tick_rate(20_000.5)) == 20_000.5


@pytest.mark.parametrize(
    ("register", "data"),
    [
        (Identity, b"NOPE\x01\x00\x01\x00"),
        (Identity, b"S4CM"),
        (Geometry, bytes(12)),
        (Status, b"\xff" * 32),
    ],
)
def test_a_register_that_is_not_ours_is_refused(register, data):
    with pytest.raises(DeviceError, match="expected"):
        register.decode(data)
