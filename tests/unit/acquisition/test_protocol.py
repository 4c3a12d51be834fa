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
    encode_block,
)
from acquisition.devices.registers import (
    Geometry,
    Identity,
    State,
    Status,
    TickRate,
    pixel_format,
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
    return Block(block_id, first_plane, first_plane * 50_000, layout, packed, 1, 3, 1, 70_000)


def three_blocks() -> tuple[list[Block], bytes]:
    layout = PlaneLayout(9, 5)
    blocks = [make_block(layout, 4, block_id=i, first_plane=4 * i, seed=i) for i in range(3)]
    return blocks, b"".join(map(encode_block, blocks))


def parse(data: bytes, cuts: list[int]) -> tuple[list[Block], list[int], BlockParser]:
    """Blocks, and how many bytes were skipped before those that came behind damage."""
    parser, blocks, damages = BlockParser(), [], []
    edges = [0, *sorted(cuts), len(data)]
    for first, last in itertools.pairwise(edges):
        parser.feed(data[first:last])
        while (found := parser.next()) is not None:
            skipped = parser.skipped_bytes - sum(damages)
            damages += [skipped] if skipped else []
            blocks.append(found)
    return blocks, damages, parser


def assert_same(found: Block, expected: Block) -> None:
    for name in (
        "block_id",
        "first_plane",
        "device_time_ns",
        "layout",
        "sync_pulses",
        "dropped_planes",
        "status",
        "pulse_age_ns",
    ):
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
        assert damages[0] == len(stream) // 3


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
    assert sum(damages) == len(noise)
    assert_same(found[0], blocks[0])


def test_a_payload_that_looks_like_a_leader_is_kept():
    layout = PlaneLayout(64, 8)
    packed = np.frombuffer((b"S4LD" * 16), dtype=np.uint8).reshape(1, 64)
    data = encode_block(Block(0, 0, 0, layout, packed))
    found, damages, _ = parse(data, [70, 90])
    assert not damages
    np.testing.assert_array_equal(found[0].packed, packed)


FAULTS = 1000  # of each kind


def test_every_gap_repeat_and_bad_crc_is_found_and_nothing_else():
    rng = np.random.default_rng(3)
    layout, planes = PlaneLayout(9, 5), 4
    count = 10 * FAULTS
    hit = 2 * rng.choice(np.arange(1, count // 2), 3 * FAULTS, replace=False)  # no two side by side
    lost, repeated, broken = (set(part.tolist()) for part in np.split(hit, 3))
    stream = bytearray()
    for i in range(count):
        data = bytearray(encode_block(make_block(layout, planes, i, i * planes, seed=i)))
        if i in broken:
            data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        stream += data * (i in repeated) + data * (i not in lost)
    blocks, damages, parser = parse(bytes(stream), np.sort(rng.integers(0, len(stream), 5000)).tolist())
    kept = [block for n, block in enumerate(blocks) if not n or block.block_id != blocks[n - 1].block_id]
    assert [block.block_id for block in kept] == [i for i in range(count) if i not in lost | broken]
    assert parser.damages == len(damages) == len(blocks) - len(kept) == FAULTS
    assert set(damages) == {len(data)}
    gaps, next_plane = [], 0
    for block in kept:
        if block.first_plane > next_plane:
            gaps.append(next_plane // planes)
        next_plane = block.first_plane + len(block.packed)
    assert gaps == sorted(lost | broken)


def test_a_block_that_was_cut_costs_no_other():
    _, stream = three_blocks()
    size = len(stream) // 3
    for kept in (1, 63, 64, 65, size - 1):
        found, damages, _ = parse(stream[:kept] + stream[size:], [])
        assert [b.block_id for b in found] == [1, 2]
        assert damages == [kept]


@pytest.mark.parametrize("eager", [True, False])
def test_blocks_that_come_whole_keep_their_place_among_pieces(eager):
    blocks = [make_block(PlaneLayout(9, 5), 4, i, 4 * i, seed=i) for i in range(6)]
    whole = [encode_block(block) for block in blocks]
    fed = [
        whole[0],
        b"noise",
        whole[1],
        whole[2][:100],
        whole[2][100:] + whole[3][:5],
        whole[3][5:],
        whole[4],
        whole[5],
    ]
    parser, found = BlockParser(), []
    for piece_fed in fed:
        parser.feed(piece_fed)
        found += iter(parser.next, None) if eager else []
    found += iter(parser.next, None)
    assert (parser.damages, parser.skipped_bytes) == (1, 5)
    for one, other in zip(found, blocks, strict=True):
        assert_same(one, other)


def test_a_leader_that_promises_more_than_the_camera_sends_is_not_waited_for():
    blocks, stream = three_blocks()
    size = len(blocks[0].packed.tobytes())
    parser = BlockParser(max_payload_bytes=size)
    parser.feed(encode_block(make_block(PlaneLayout(400, 250), 80))[:64] + stream)
    found = list(iter(parser.next, None))
    assert (parser.damages, parser.skipped_bytes) == (1, 64)
    assert [b.block_id for b in found] == [0, 1, 2]


def check_noise(data) -> None:
    """Whatever comes first, the two blocks behind it are found, and every byte is one or the other."""
    _, stream = three_blocks()
    pieces = st.one_of(st.binary(max_size=120), st.just(b"S4LD"), st.just(b"S4TR"), st.integers(0, 400).map(piece))
    noise = b"".join(data.draw(st.lists(pieces, max_size=12)))
    parser = BlockParser()
    for start in range(0, len(noise), 37):
        parser.feed(noise[start : start + 37])
        while parser.next() is not None:
            pass
    parser.feed(stream * 2)  # what the noise had begun may take the first with it
    ids = [found.block_id for found in iter(parser.next, None)]
    assert ids[-3:] == [0, 1, 2]


def piece(seed: int) -> bytes:
    """A part of a stream, with a flipped bit here and there."""
    rng = np.random.default_rng(seed)
    stream = bytearray(three_blocks()[1])
    for _ in range(rng.integers(3)):
        stream[rng.integers(len(stream))] ^= 1 << rng.integers(8)
    first, last = sorted(rng.integers(0, len(stream), 2))
    return bytes(stream[first:last])


@settings(max_examples=200)
@given(st.data())
def test_noise_of_any_kind_neither_stops_nor_breaks_the_parser(data):
    check_noise(data)


@pytest.mark.slow
@pytest.mark.long
@settings(max_examples=10_000)
@given(st.data())
def test_ten_thousand_kinds_of_noise(data):
    check_noise(data)


@given(layouts, st.integers(1, 1000))
def test_the_geometry_register_round_trips(layout, planes):
    assert Geometry.decode(Geometry(layout, planes).encode()) == Geometry(layout, planes)


def test_the_other_registers_round_trip():
    status = Status(State.ARMED, 3, 10**12, 7)
    assert Status.decode(status.encode()) == status
    assert Identity.decode(Identity(1, 4).encode()) == Identity(1, 4)
    assert TickRate.decode(TickRate(20_000.5).encode()).hz == 20_000.5


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


def test_a_layout_with_columns_behind_its_pixels_has_no_pixel_format():
    with pytest.raises(DeviceError, match="found 16 columns behind the pixels, expected none"):
        pixel_format(PlaneLayout(400, 250, trailing_columns=16))
