"""Whatever a recording's files hold, reading them ends in a value or in one of our errors, of one line."""

import contextlib
import json
import random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquisition.recording.compaction import compact
from acquisition.recording.finalise import finalise
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import PlaneLayout
from rigs.camera import Camera
from rigs.errors import Spike4dgsError
from rigs.rig import Rig
from rigs.toml import dump_rig
from rigs.transform import Transform

LAYOUT = PlaneLayout(9, 5)
RIG = Rig("pair", 20_000.0, tuple(Camera(i, 9, 5, 8.0, 8.0, 4.5, 2.5, Transform.identity()) for i in ("a", "b")))
QUICK, MANY = 150, 10_000
quick = settings(max_examples=QUICK, suppress_health_check=[HealthCheck.function_scoped_fixture])

scalars = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.integers(-3, 300),
    st.floats(),
    st.text(max_size=8),
    st.sampled_from(
        ["a.dat", "b.dat", "/etc/passwd", "..", "rig.toml", "\0", "ring", "incomplete", "armed", "recording"]
    ),
)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


@pytest.fixture(scope="module", params=["dat", "compact"])
def recorded(request, tmp_path_factory):
    out = tmp_path_factory.mktemp("fuzz") / "rec"
    planes = np.random.default_rng(0).integers(0, 256, (200, LAYOUT.plane_bytes), dtype=np.uint8)
    with RecordingWriter(out, RIG) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in RIG.ids]
        for stream in streams:
            stream.append(planes)
            stream.close()
        recording.commit(recording.entries(), "line")
    if request.param == "compact":
        compact(out)
    return out


def places(document, at=()) -> list[tuple]:
    """The way to every value of a JSON document."""
    inside = document.items() if isinstance(document, dict) else enumerate(document)
    found = []
    for key, value in inside:
        found.append((*at, key))
        if isinstance(value, dict | list):
            found += places(value, (*at, key))
    return found


def change(document, place: tuple, value, *, remove: bool) -> None:
    for key in place[:-1]:
        document = document[key]
    if remove:
        del document[place[-1]]
    else:
        document[place[-1]] = value


@contextlib.contextmanager
def our_errors():
    try:
        yield
    except Spike4dgsError as error:
        if "\n" in str(error):
            raise AssertionError(f"an error of several lines: {error!r}") from error


def read_all(folder) -> None:
    """Read what there is; our own errors are the only ones allowed."""
    with our_errors():
        found = verify(folder)
        recording = Recording.open(folder)
        for camera_id in recording.camera_ids:
            stream = recording.stream(camera_id)
            assert len(stream) == recording.manifest.camera(camera_id).planes
            assert stream.window(0, 1).shape == (1, stream.layout.plane_bytes)
        assert recording.planes >= 0
        assert all(str(damaged) for damaged in found)


def read_changed(folder, changes) -> None:
    path = folder / "recording.json"
    good = path.read_text()
    document = json.loads(good)
    for pick, value, remove in changes:
        found = places(document)
        if found:
            change(document, found[pick % len(found)], value, remove=remove)
    try:
        path.write_text(json.dumps(document))
        read_all(folder)
    finally:
        path.write_text(good)


changes = st.lists(st.tuples(st.integers(0, 10**6), values, st.booleans()), min_size=1, max_size=3)


KINDS = [None, True, 0, -1, 1, 2**70, 0.0, 1.5, float("nan"), float("inf"), "", "x", "\n", [], [0.0], {}, {"x": None}]


@pytest.mark.parametrize("kind", KINDS, ids=repr)
def test_every_value_of_a_manifest_may_be_of_another_kind(recorded, kind):
    for pick in range(len(places(json.loads((recorded / "recording.json").read_text())))):
        read_changed(recorded, [(pick, kind, False)])


@quick
@given(changes)
def test_a_changed_manifest_is_read_or_refused(recorded, changes):
    read_changed(recorded, changes)


@pytest.mark.slow
@pytest.mark.long
@settings(max_examples=MANY, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(changes)
def test_ten_thousand_changed_manifests_are_read_or_refused(recorded, changes):
    read_changed(recorded, changes)


def scramble(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut out, repeated or put in."""
    found = bytearray(data)
    for _ in range(rng.randint(1, 6)):
        at, size = rng.randrange(len(found) + 1), rng.randrange(1, 9)
        what = rng.randrange(4)
        if what == 0:
            found[at : at + size] = rng.randbytes(size)
        elif what == 1:
            del found[at : at + size * 20]
        elif what == 2:
            found[at:at] = found[at : at + size * 5]
        else:
            found[at:at] = rng.randbytes(size)
    return bytes(found)


def read_scrambled(folder, seed: int) -> None:
    path = folder / "recording.json"
    good = path.read_bytes()
    try:
        path.write_bytes(scramble(good, random.Random(seed)))
        read_all(folder)
    finally:
        path.write_bytes(good)


@pytest.mark.parametrize("seed", range(5))
def test_scrambled_manifests_are_read_or_refused(recorded, seed):
    for number in range(40):
        read_scrambled(recorded, seed * 1000 + number)


def repair_scrambled(parent, seed: int) -> None:
    """A crash's journal or planes, scrambled: what `finalise` makes of them verifies."""
    rng = random.Random(seed)
    planes = np.frombuffer(rng.randbytes(200 * LAYOUT.plane_bytes), dtype=np.uint8).reshape(200, -1)
    with RecordingWriter(parent / "rec", RIG) as recording:
        streams = [recording.stream(camera_id, LAYOUT) for camera_id in RIG.ids]
        recording.mark("recording", "line")
        for stream in streams:
            stream.append(planes)
            stream.close()
        kept = recording.folder.rename(parent / "kept")
        recording.folder.mkdir()
    folder = kept.rename(parent / "rec.partial")
    victim = folder / rng.choice(["a.journal", "b.journal", "a.dat", "recording.json"])
    victim.write_bytes(scramble(victim.read_bytes(), rng))
    with our_errors():
        finalise(parent / "rec")
        damaged = {found.file for found in verify(parent / "rec")}
        assert damaged <= ({"rig.toml"} if victim.name == "recording.json" else set())  # its SHA-256 was scrambled
        assert planes.tobytes().startswith((parent / "rec/b.dat").read_bytes())


@pytest.mark.parametrize("seed", range(20))
def test_what_finalise_makes_of_a_scrambled_crash_verifies(tmp_path, seed):
    repair_scrambled(tmp_path, seed)


@pytest.mark.slow
def test_what_finalise_makes_of_many_scrambled_crashes_verifies(tmp_path):
    for seed in range(20, 320):
        (tmp_path / str(seed)).mkdir()
        repair_scrambled(tmp_path / str(seed), seed)


imports = st.fixed_dictionaries(
    {
        "sizes": st.lists(st.integers(0, 1500), min_size=0, max_size=3),
        "names": st.lists(st.sampled_from(["", "a=", "b=", "c=", "a=b=", "=", "cam00="]), min_size=3, max_size=3),
        "rate": st.floats() | st.sampled_from([20_000.0, 1.0]),
        "size": st.none() | st.tuples(st.integers(-2, 70_000), st.integers(-2, 20)),
        "partial": st.booleans(),
        "orders": st.tuples(st.sampled_from(["lsb", "msb"]), st.sampled_from(["bottom", "top"])),
        "cut": st.none() | st.integers(0, 2**32),
    }
)


def import_anything(folder, given_) -> None:
    rig = folder / "rig.toml"
    text = dump_rig(RIG).encode()
    rig.write_bytes(text if given_["cut"] is None else scramble(text, random.Random(given_["cut"])))
    dats = []
    for number, size in enumerate(given_["sizes"]):
        path = folder / f"{number}.dat"
        path.write_bytes(random.Random(size).randbytes(size))
        dats.append(f"{given_['names'][number]}{path}")
    bit_order, row_order = given_["orders"]
    options = dict(size=given_["size"], bit_order=bit_order, row_order=row_order, allow_partial=given_["partial"])
    out = folder / "rec"
    with our_errors():
        import_recording(dats, rig, out, ImportOptions(given_["rate"], **options))
        assert verify(out) == []
        for path in out.iterdir():
            path.unlink()
        out.rmdir()
    assert not out.exists()
    assert not out.with_name("rec.partial").exists()


@quick
@given(imports)
def test_any_dat_is_imported_or_refused(tmp_path, given_):
    import_anything(tmp_path, given_)


@pytest.mark.slow
@pytest.mark.long
@settings(max_examples=MANY, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(imports)
def test_ten_thousand_dats_are_imported_or_refused(tmp_path, given_):
    import_anything(tmp_path, given_)
