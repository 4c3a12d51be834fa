"""Ticks choose a part of what is written and of what is reconstructed; instants stay those of the whole."""

import json

import av
import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from reconstruction.errors import BadRunError
from reconstruction.export.catalogue import FORMATS, checked_format, export_scene
from reconstruction.export.scene import TICKS, Choices
from reconstruction.export.viewer import write_viewer
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.scene_model import TimeSpan
from reconstruction.truth import Truth
from rigs.clock import RigClock

OVER_TIME = {"tracks", "ply-sequence", "video", "depth", "nerfstudio", "viewer"}


def part(first, last, **others):
    return Choices(from_tick=first, to_tick=last, **others)


def test_formats_over_time_take_ticks_and_the_others_refuse_them():
    assert {name for name, form in FORMATS.items() if set(TICKS) <= set(form.takes)} == OVER_TIME
    for name in set(FORMATS) - OVER_TIME:
        for choices, option in ((part(1, None), "--from-tick"), (part(None, 3), "--to-tick")):
            with pytest.raises(BadRunError, match=f"{option} for {name}, which takes") as refused:
                checked_format(name, choices)
            assert "\n" not in str(refused.value)


def test_a_sequence_of_a_part_has_its_instants(scene_with, tmp_path):
    scene = scene_with()  # ticks 40 to 239
    export_scene(scene, "ply-sequence", tmp_path / "part", part(100, 120, frames=20))
    manifest = json.loads((tmp_path / "part" / "manifest.json").read_text())
    clock = RigClock(scene.rig.tick_rate_hz)
    found = [frame["instant_s"] for frame in manifest["frames"]]
    np.testing.assert_allclose(found, [clock.instant_s(tick) for tick in range(100, 120)], rtol=1e-12)
    np.testing.assert_allclose(manifest["clip_s"], [clock.begins_s(100), clock.begins_s(120)], rtol=1e-12)
    export_scene(scene, "ply-sequence", tmp_path / "one", part(100, 101, frames=1))
    lone = (tmp_path / "one" / "000000.ply").read_bytes()
    assert lone == (tmp_path / "part" / "000000.ply").read_bytes()


def test_an_open_end_is_the_scene_s(scene_with, tmp_path):
    scene = scene_with()
    for number, (choices, ends) in enumerate(((part(None, 41), (40, 41)), (part(239, None), (239, 240)))):
        export_scene(scene, "depth", tmp_path / str(number), Choices(**{**vars(choices), "frames": 1}))
        manifest = json.loads((tmp_path / str(number) / "manifest.json").read_text())
        np.testing.assert_allclose(manifest["clip_s"], np.array(ends) / 20000, rtol=1e-12)


@pytest.mark.parametrize(
    ("first", "last"), [(39, 50), (100, 241), (60, 60), (80, 60), (-5, None), (None, 40), (10**12, None)]
)
def test_ticks_that_the_scene_lacks_are_refused_in_one_line(scene_with, tmp_path, first, last):
    with pytest.raises(BadRecordingError, match=r"ticks from 40 to 240.*--from-tick") as refused:
        export_scene(scene_with(), "video", tmp_path / "v.mp4", part(first, last))
    assert "\n" not in str(refused.value)
    assert refused.value.exit_code == 2
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("camera", [None, "cam01"])
def test_a_video_of_one_tick_shows_that_tick(camera, scene_with, tmp_path):
    scene = scene_with()
    for name, choices in (("a", part(60, 61)), ("b", part(220, 221))):
        export_scene(
            scene, "video", tmp_path / f"{name}.mp4", Choices(**{**vars(choices), "frames": 1, "camera": camera})
        )
    pictures = []
    for name in ("a", "b"):
        with av.open(str(tmp_path / f"{name}.mp4")) as video:
            pictures.append([frame.to_ndarray(format="gray") for frame in video.decode(video=0)])
    assert [len(shown) for shown in pictures] == [1, 1]
    assert np.abs(pictures[0][0].astype(int) - pictures[1][0]).max() > 20  # its movers are elsewhere


def viewer_files(scene, folder, choices):
    export_scene(scene, "viewer", folder, choices)
    return json.loads((folder / "viewer.json").read_text()), (folder / "viewer.bin").read_bytes()


@pytest.mark.parametrize("kind", ["linear", "bases", "4dgs"])
def test_the_viewer_of_a_part_plays_the_same_movers_in_less_time(kind, scene_with, tmp_path):
    scene = scene_with(kind)
    document, data = viewer_files(scene, tmp_path / "part", part(100, 140))
    (tmp_path / "whole").mkdir()
    write_viewer(tmp_path / "whole", scene)
    whole = json.loads((tmp_path / "whole" / "viewer.json").read_text())
    [span] = document["spans"]
    assert document["version"] == 2
    assert document["clip_s"] == [span["first_s"], span["last_s"]] == [0.005, 0.007]
    assert span["clip_s"] == whole["clip_s"]
    motion = "bodies" if kind == "bases" else whole["motion"]
    assert (span["moving"], span["motion"]) == (whole["moving"], motion)
    assert (document["still"], span["changed"]) == (whole["still"], 0)
    assert span["offset"] + span["length"] == len(data)


@pytest.fixture
def spanned(scene_with):
    scene = scene_with("linear", still=10, moving=6)
    spans = []
    for number in range(4):
        own = SpanContent.as_usual(TimeSpan(number / 50, (number + 1) / 50))
        own.cloud = scene_with("linear", still=0, moving=3 + number).cloud
        own.cloud.clip = TimeSpan(max(0.0, number / 50 - 0.001), (number + 1) / 50 + 0.001)
        spans.append(own)
    scene.cloud.still.opacity_logits[:2] = -9.0
    for number in (0, 3):  # still ones that only one span shows
        spans[number].changed = scene.cloud.still.opacity_logits.argsort()[number // 3 : number // 3 + 1]
        spans[number].opacity_logits, spans[number].intensities = (
            scene.cloud.still.opacity_logits[2:3] * 0 + 2,
            scene.cloud.still.intensities[:1],
        )
    cloud = SpannedScene(scene.cloud.still, spans, TimeSpan(0.0, 0.08))
    return type(scene)(cloud, scene.rig, scene.white, "bases", "cam01", dict)


@pytest.mark.parametrize(
    ("first", "last", "touched"),
    [
        (0, 1600, [0, 1, 2, 3]),
        (0, 400, [0]),
        (400, 800, [1]),
        (399, 401, [0, 1]),
        (500, 1300, [1, 2, 3]),
        (1599, 1600, [3]),
    ],
)
def test_the_viewer_of_a_part_has_the_spans_it_touches(spanned, tmp_path, first, last, touched):
    document, data = viewer_files(spanned, tmp_path / "part", part(first, last))
    spans = document["spans"]
    assert [span["moving"] for span in spans] == [3 + number for number in touched]
    assert [span["first_s"] for span in spans[1:]] == [number / 50 for number in touched[1:]]
    np.testing.assert_allclose([spans[0]["first_s"], spans[-1]["last_s"]], [first / 20000, last / 20000], rtol=1e-12)
    assert [span["clip_s"] for span in spans] == [
        [spanned.cloud.spans[n].cloud.clip.first_s, spanned.cloud.spans[n].cloud.clip.last_s] for n in touched
    ]
    assert document["still"] == 8 + (0 in touched) + (3 in touched)  # what no span of the part shows is left out
    assert spans[-1]["offset"] + spans[-1]["length"] == len(data)


def test_a_part_of_a_scene_shows_what_the_scene_shows(spanned):
    cut = SpannedScene.over(spanned.cloud, TimeSpan(0.025, 0.055))
    assert [len(cut.spans), len(cut.spans[1:])] == [2, 1]
    for instant_s in (0.025, 0.0399, 0.04, 0.0549):
        for mine, whole in zip(cut.at(instant_s), spanned.cloud.at(instant_s), strict=True):
            np.testing.assert_array_equal(mine.numpy(), whole.numpy())


@pytest.fixture
def truth(tmp_path):
    (tmp_path / "cam00").mkdir()
    (tmp_path / "scene.json").write_text(json.dumps({"white": 1.0, "movers": [{"id": 1}]}))
    for tick in range(0, 100, 20):
        for kind in ("", "depth_", "id_", "blur_"):
            np.save(tmp_path / "cam00" / f"{kind}{tick:06d}.npy", np.full((2, 2), tick / 128, np.float32))
    return Truth.open(tmp_path)


def test_the_truth_of_a_part_is_numbered_from_its_first_plane(truth):
    assert truth.planes("cam00") == [0, 20, 40, 60, 80]
    own = truth.within(range(30, 70))
    assert own.planes("cam00") == [10, 30]
    for plane, tick in ((10, 40), (30, 60)):
        assert own.frame("cam00", plane).intensity[0, 0] == tick / 128 == own.blurred("cam00", plane)[0, 0]
        assert own.frame("cam00", plane).plane == plane
    assert own.within(range(80, 100)).planes("cam00") == [0]
    with pytest.raises(BadRunError, match=r"no truth of cam00 in ticks 41 to 60.* from 0 to 80"):
        truth.within(range(41, 60)).planes("cam00")
    assert [truth.within(range(*ticks)).knows("cam00") for ticks in ((40, 41), (41, 60), (81, 200))] == [
        True,
        False,
        False,
    ]
    assert truth.knows("cam00")
    assert not truth.knows("cam99")
    with pytest.raises(BadRunError, match="plane 45"):
        own.frame("cam00", 15)


def test_a_configuration_refuses_reversed_ticks_and_is_read_back():
    config = ReconstructionConfig(from_tick=400, to_tick=800)
    assert ReconstructionConfig.from_json({**vars(config), "views": []}) == config
    older = {name: value for name, value in vars(config).items() if name not in TICKS}
    assert ReconstructionConfig.from_json({**older, "views": []}).to_tick is None
    for first, last in ((5, 5), (6, 5)):
        with pytest.raises(BadRunError, match=f"ticks {first} to {last}.*--from-tick"):
            ReconstructionConfig(from_tick=first, to_tick=last)
