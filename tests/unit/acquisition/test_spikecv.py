"""SpikeCV's sidecar, both ways."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import CameraFile, Manifest
from acquisition.recording.spikecv import SpikeCVConfig, dump_config, read_config, write_config
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
    config = read_config(tmp_path / "config.yaml")
    assert config == SpikeCVConfig("vidar_reconstruction2019", 400, 250)
    assert dump_config(config) == PUBLIC


@given(
    st.builds(
        SpikeCVConfig,
        st.text(st.characters(codec="utf-8"), max_size=20),
        st.integers(1, 9999),
        st.integers(1, 9999),
        st.booleans(),
        st.lists(st.sampled_from([0, 1, 2, 3.1, 3.2, 4, 5, 6, 7]), max_size=4).map(tuple),
        st.none() | st.sampled_from(["txt", "png"]),
    )
)
def test_a_config_survives_the_disk(tmp_path_factory, config):
    path = tmp_path_factory.mktemp("yaml") / "config.yaml"
    path.write_text(dump_config(config), encoding="utf-8")
    assert read_config(path) == config


@pytest.mark.parametrize("text", ["", "[]", "3", "a: [", "\x00", "[" * 400, "spike_w: 400", "!!python/object:x.y {}"])
@pytest.mark.parametrize("more", ["", "\nspike_w: wide\nspike_h: 2", "\nspike_w: true\nspike_h: 2"])
def test_what_is_no_config_is_refused_by_name(tmp_path, text, more):
    (tmp_path / "config.yaml").write_text(text + more)
    with pytest.raises(BadRecordingError, match=r"config\.yaml"):
        read_config(tmp_path / "config.yaml")
    with pytest.raises(BadRecordingError, match="cannot be read"):
        read_config(tmp_path / "other.yaml")


@pytest.mark.parametrize("field", ["spike_h: 0", "spike_h: -4", "spike_h: 2.5", "spike_h: 2\nlabeled_data_type: [x]"])
def test_a_field_that_cannot_be_is_named(tmp_path, field):
    (tmp_path / "config.yaml").write_text(f"spike_w: 4\n{field}")
    with pytest.raises(BadRecordingError, match=field.split("\n")[-1].split(":")[0]):
        read_config(tmp_path / "config.yaml")


def manifest(*layouts: PlaneLayout) -> Manifest:
    files = tuple(
        CameraFile(f"cam0{n}", f"cam0{n}.dat", layout, 1, 0, 1, ("0" * 16,), "ab" * 32)
        for n, layout in enumerate(layouts)
    )
    return Manifest(20_000.0, "import", "spike4dgs", "cd" * 32, files)


def test_a_recording_gets_its_config(tmp_path):
    path = write_config(tmp_path, manifest(PlaneLayout(400, 250, trailing_columns=16)))
    assert read_config(path) == SpikeCVConfig(tmp_path.name, 416, 250)


@pytest.mark.parametrize(
    ("layouts", "word"),
    [((PlaneLayout(8, 8), PlaneLayout(9, 8)), "2 sizes"), ((PlaneLayout(8, 8, "msb"),), "msb first")],
)
def test_what_spikecv_cannot_read_is_not_described(tmp_path, layouts, word):
    with pytest.raises(BadRecordingError, match=word):
        write_config(tmp_path, manifest(*layouts))
    assert list(tmp_path.iterdir()) == []
