import dataclasses
import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import (
    CameraFile,
    Compact,
    Conversion,
    Gap,
    Manifest,
    block_planes_of,
    dump_manifest,
    load_manifest,
)
from acquisition.spikes.layout import PlaneLayout

conversions = st.builds(
    Conversion,
    st.just("m1k40"),
    st.just("ef" * 32),
    st.integers(0, 10**6),
    st.lists(st.tuples(st.integers(0, 500), st.integers(1, 2000)), max_size=3).map(tuple),
)


@st.composite
def gaps(draw, planes: int) -> tuple[Gap, ...]:
    """In order, inside `planes` planes."""
    edges = sorted(draw(st.sets(st.integers(0, planes), max_size=6)))
    layers = st.sampled_from(["device", "link", "ring", "disk"])
    pairs = zip(edges[::2], edges[1::2], strict=False)
    return tuple(Gap(first, last - first, draw(layers)) for first, last in pairs)


@st.composite
def cameras(draw, camera_id: str) -> CameraFile:
    planes, block = draw(st.integers(1, 500)), draw(st.integers(1, 80))
    return CameraFile(
        camera_id,
        f"{camera_id}.dat",
        PlaneLayout(
            draw(st.integers(1, 999)), 7, draw(st.sampled_from(["lsb", "msb"])), "top", draw(st.integers(0, 9))
        ),
        planes,
        0,
        block,
        tuple(f"{i:016x}" for i in range(-(-planes // block))),
        "ab" * 32,
        draw(gaps(planes)),
        draw(st.none() | st.floats(-1, 1)),
        draw(st.integers(0, 12_499)),
        draw(st.none() | conversions),
        draw(st.none() | st.floats(0, 1)),
        compact=draw(st.none() | st.just(Compact(f"{camera_id}.compact", 8, (7,) * -(-planes // 8)))),
    )


@st.composite
def manifests(draw) -> Manifest:
    ids = [f"cam0{i}" for i in range(draw(st.integers(1, 3)))]
    rate = draw(st.floats(1e-3, 1e6))
    trigger = draw(st.sampled_from(["line", "software", "import"]))
    return Manifest(rate, trigger, "spike4dgs 0.1.0", "cd" * 32, tuple(draw(cameras(i)) for i in ids))


EXAMPLE = Manifest(
    20_000.0,
    "line",
    "spike4dgs 0.1.0",
    "cd" * 32,
    (CameraFile("cam00", "cam00.dat", PlaneLayout(9, 5), 3, 0, 80, ("0" * 16,), "ab" * 32, (Gap(1, 2, "link"),)),),
)


@given(manifests())
def test_a_manifest_survives_the_disk(manifest):
    assert load_manifest(dump_manifest(manifest)) == manifest


def test_the_json_says_what_the_architecture_promises():
    document = json.loads(dump_manifest(EXAMPLE))
    assert {"schema_version", "tick_rate_hz", "trigger", "writer", "rig_sha256", "cameras"} <= set(document)
    assert (document["status"], document["reason"]) == ("complete", None)
    camera = document["cameras"][0]
    assert camera["drops"] == {"device": 0, "link": 2, "ring": 0, "disk": 0}
    assert (camera["offered"], camera["written"]) == (3, 1)
    layout = {"width": 9, "height": 5, "bit_order": "lsb", "row_order": "bottom", "trailing_columns": 0}
    assert camera["layout"] == layout


def test_a_manifest_of_an_earlier_writer_is_read():
    document = json.loads(dump_manifest(EXAMPLE))
    for key in ("status", "reason", "direct_io", "trigger_plane"):
        del document[key]
    camera = document["cameras"][0]
    camera["drops"] = {"device": 0, "link": 2}
    del camera["offered"], camera["written"]
    assert load_manifest(json.dumps(document)) == EXAMPLE


@pytest.mark.parametrize("text", ["", "[]", "3", "{}", "nonsense", '{"schema_version": 1}', "[" * 100_000])
def test_what_is_no_manifest_is_refused(text):
    with pytest.raises(BadRecordingError, match=r"recording\.json"):
        load_manifest(text)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("schema_version",), 3),
        (("tick_rate_hz",), 0),
        (("trigger",), "bell"),
        (("cameras",), []),
        (("surprise",), 1),
        (("cameras", 0, "planes"), 0),
        (("cameras", 0, "planes"), 81),
        (("cameras", 0, "file"), "../cam00.dat"),
        (("cameras", 0, "drops", "link"), 1),
        (("cameras", 0, "offered"), 4),
        (("cameras", 0, "written"), 2),
        (("cameras", 0, "planes"), 1.5),
        (("cameras", 0, "gaps", 0, "first_plane"), 2),
        (("cameras", 0, "file"), "cam00\0.dat"),
        (("status",), "incomplete"),
        (("status",), "lost"),
        (("reason",), "no reason"),
        (("cameras", 0, "layout", "width"), -4),
        (("cameras", 0, "compact"), {"file": "../a", "block_planes": 8, "block_bytes": [9]}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 0, "block_bytes": [9]}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 2**30, "block_bytes": [9]}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 8, "block_bytes": []}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 8, "block_bytes": [0]}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 8, "block_bytes": [9, 9]}),
        (("cameras", 0, "compact"), {"file": "a", "block_planes": 8, "block_bytes": [9], "coding": "other"}),
        (("cameras", 0, "gaps", 0, "layer"), "moon"),
    ],
)
def test_a_manifest_that_contradicts_itself_is_refused(path, value):
    document = json.loads(dump_manifest(EXAMPLE))
    place = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(BadRecordingError):
        load_manifest(json.dumps(document))


def test_a_camera_may_appear_once():
    with pytest.raises(BadRecordingError, match="each once"):
        dataclasses.replace(EXAMPLE, cameras=EXAMPLE.cameras * 2)
    with pytest.raises(BadRecordingError, match="cam00"):
        EXAMPLE.camera("cam99")


def test_a_digest_covers_about_a_megabyte():
    assert block_planes_of(PlaneLayout(400, 250)) == 80
    assert block_planes_of(PlaneLayout(1000, 1000)) == 8
    assert block_planes_of(PlaneLayout(9000, 9000)) == 1
