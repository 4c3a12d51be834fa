"""SpikeCV's sidecar, both ways."""

import pytest

from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import CameraFile, Manifest
from acquisition.recording.spikecv import read_size, write_config
from acquisition.spikes.layout import PlaneLayout

PUBLIC = """filename: vidar_reconstruction2019
spike_w: 400
spike_h: 250
is_labeled: false
labeled_data_type: [0]
labeled_data_suffix: None
"""


def test_a_public_config_is_read(tmp_path):
    (tmp_path / "config.yaml").write_text(PUBLIC)
    assert read_size(tmp_path / "config.yaml") == (400, 250)


@pytest.mark.parametrize("text", ["", "[]", "3", "a: [", "\x00", "[" * 400, "spike_w: 400", "!!python/object:x.y {}"])
@pytest.mark.parametrize("more", ["", "\nspike_w: wide\nspike_h: 2", "\nspike_w: true\nspike_h: 2"])
def test_what_is_no_config_is_refused_by_name(tmp_path, text, more):
    (tmp_path / "config.yaml").write_text(text + more)
    with pytest.raises(BadRecordingError, match=r"config\.yaml"):
        read_size(tmp_path / "config.yaml")
    with pytest.raises(BadRecordingError, match="cannot be read"):
        read_size(tmp_path / "other.yaml")


@pytest.mark.parametrize("field", ["spike_h: 0", "spike_h: -4", "spike_h: 2.5"])
def test_a_field_that_cannot_be_is_named(tmp_path, field):
    (tmp_path / "config.yaml").write_text(f"spike_w: 4\n{field}")
    with pytest.raises(BadRecordingError, match=field):
        read_size(tmp_path / "config.yaml")


def manifest(*layouts: PlaneLayout) -> Manifest:
    files = tuple(
        CameraFile(f"cam0{n}", f"cam0{n}.dat", layout, 1, 0, 1, ("0" * 16,), "ab" * 32)
        for n, layout in enumerate(layouts)
    )
    return Manifest(20_000.0, "import", "spike4dgs", "cd" * 32, files)


def test_a_recording_gets_its_config(tmp_path):
    folder = tmp_path / "vidar_reconstruction2019"
    folder.mkdir()
    path = write_config(folder, manifest(PlaneLayout(400, 250, trailing_columns=16)))
    assert path.read_text() == PUBLIC.replace("400", "416")
    assert read_size(path) == (416, 250)


@pytest.mark.parametrize(
    ("layouts", "word"),
    [((PlaneLayout(8, 8), PlaneLayout(9, 8)), "2 sizes"), ((PlaneLayout(8, 8, "msb"),), "msb first")],
)
def test_what_spikecv_cannot_read_is_not_described(tmp_path, layouts, word):
    with pytest.raises(BadRecordingError, match=word):
        write_config(tmp_path, manifest(*layouts))
    assert list(tmp_path.iterdir()) == []
