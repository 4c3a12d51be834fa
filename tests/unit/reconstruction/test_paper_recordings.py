"""Tests how a recording is prepared for a method, and the images a camera would have blurred."""

import json
from dataclasses import replace

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.recording.reader import Recording
from acquisition.recording.verify import verify
from acquisition.scenes.misplaced import misplaced
from acquisition.session.record import simulate
from reconstruction.bench.paper.changed import changed
from reconstruction.bench.paper.method import Change
from reconstruction.errors import BadRunError
from reconstruction.images.composite import CompositeSource
from reconstruction.pipeline.given import given_source
from reconstruction.truth import Truth
from rigs.toml import catalog_rig

PLANES, SEED = 60, 5


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    path = tmp_path_factory.mktemp("paper") / "rec"
    rig = catalog_rig("ci3x3")
    rig = replace(rig, cameras=tuple(c.scaled(40, 30) for c in rig.cameras))
    simulate(Simulation("fan_and_ball", seed=1), rig, PLANES, path)
    return Recording.open(path)


def test_what_is_not_changed_is_not_copied(recording, tmp_path):
    assert changed(recording.path, tmp_path / "own", Change(), SEED) == recording.path
    assert not (tmp_path / "own").exists()


def test_a_nominal_rig_is_misplaced_and_keeps_spikes_and_truth(recording, tmp_path):
    own = Recording.open(changed(recording.path, tmp_path / "own", Change(nominal=True), SEED))
    assert not verify(own.path)
    expected = misplaced(recording.rig, 2.0, SEED)
    assert own.rig.poses == "nominal"
    for camera, wanted in zip(own.rig.cameras, expected.cameras, strict=True):
        np.testing.assert_allclose(camera.cam_from_rig.rotation, wanted.cam_from_rig.rotation, atol=1e-9)
        np.testing.assert_allclose(camera.center, wanted.center, atol=1e-9)
        assert np.array_equal(own.stream(camera.id).packed, recording.stream(camera.id).packed)
    assert own.truth is not None
    assert Truth.open(own.truth) == replace(Truth.open(recording.truth), path=own.truth)
    (own.path / "truth").unlink()  # killed before it was linked
    assert Recording.open(changed(recording.path, own.path, Change(nominal=True), SEED)).truth is not None


@pytest.mark.parametrize("every", [2, 5, 7])
def test_of_dropped_planes_the_middle_of_each_group_is_left(recording, tmp_path, every):
    own = Recording.open(changed(recording.path, tmp_path / "own", Change(every=every), SEED))
    assert (own.tick_rate_hz, own.planes, own.truth) == (20000.0 / every, PLANES // every, None)
    for camera_id in own.camera_ids:
        fast = recording.stream(camera_id).planes(0, PLANES)
        whole = PLANES // every * every
        assert np.array_equal(own.stream(camera_id).planes(0, own.planes), fast[:whole].reshape(
            PLANES // every, every, *fast.shape[1:])[:, every // 2])  # fmt: skip
    late = own.rig.clock.instant_s(3) - recording.rig.clock.instant_s(3 * every + every // 2)
    assert abs(late) * recording.tick_rate_hz == pytest.approx(0.0 if every % 2 else 0.5)


def test_reintegrated_planes_hold_the_light_of_all(recording, tmp_path):
    own = Recording.open(changed(recording.path, tmp_path / "own", Change(every=4, slowing="reintegrate"), SEED))
    fast = recording.stream("cam11").counts(0, PLANES).astype(int)
    slow = own.stream("cam11").counts(0, own.planes).astype(int)
    assert (own.tick_rate_hz, own.planes) == (5000.0, 15)
    assert np.abs(fast - 4 * slow).max() < 4
    first = own.stream("cam11").counts(0, 1).mean()
    assert first == pytest.approx(slow.mean() / own.planes, rel=0.3)  # no pixel begins empty


def test_the_name_of_a_change():
    assert Change().label == ""
    assert Change(nominal=True, every=4).label == "nominal-drop4"


class Still(CompositeSource):
    """A source of which nothing but its kind is asked."""

    def __init__(self):
        pass

    def __getattr__(self, name):
        return None


def test_clean_and_blurred_images_are_the_truths_own(recording):
    truth = Truth.open(recording.truth)
    found = {kind: given_source("cam11", Still(), recording, kind) for kind in ("clean", "blurred")}
    planes = truth.planes("cam11")
    for kind, prefix in (("clean", ""), ("blurred", "blur_")):
        assert found[kind].instants(4).tolist() == planes
        for plane in planes:
            file = recording.truth / "cam11" / f"{prefix}{plane:06d}.npy"
            assert np.array_equal(found[kind].at(plane), np.load(file))
    assert not np.allclose(found["clean"].at(planes[1]), found["blurred"].at(planes[1]))


def test_a_truth_without_blurred_images_says_so(recording, tmp_path):
    (tmp_path / "scene.json").write_text(json.dumps({"white": 1.0, "movers": []}))
    with pytest.raises(BadRunError, match="found no readable image, expected a blurred image at each plane of truth"):
        Truth.open(tmp_path).blurred("cam11", 0)
    with pytest.raises(BadRunError, match="found no truth, expected a simulated recording for the images `blurred`"):
        given_source("cam11", Still(), replace(recording, path=tmp_path / "elsewhere"), "blurred")


def test_an_ordinary_cameras_frames_are_means_of_their_exposure_and_noisy(tmp_path):
    camera_id, rig = "cam00", catalog_rig("lab3x3").only(["cam00"]).scaled(40, 25)
    simulate(Simulation("fan_and_ball", seed=1), rig, 210, tmp_path / "long")
    recording = Recording.open(tmp_path / "long")
    found = given_source(camera_id, Still(), recording, "ordinary")
    assert (found.instants(4).tolist(), found.planes) == ([49, 149], 99)
    part = given_source(camera_id, Still(), recording.part(10, 205), "ordinary")
    assert part.instants(4).tolist() == [139]
    np.testing.assert_array_equal(part.at(139), found.at(149))
    light = Truth.open(recording.truth).blurred(camera_id, 140)
    assert 0 < np.abs(found.at(149) - light).mean() < 0.2 * light.mean()


def test_a_recording_shorter_than_an_exposure_has_no_frames(recording):
    with pytest.raises(BadRunError, match="found no frame of an ordinary camera beside cam11"):
        given_source("cam11", Still(), recording, "ordinary")


def test_single_planes_gathered_are_the_recording_itself(recording, tmp_path):
    assert changed(recording.path, tmp_path / "own", Change(slowing="reintegrate"), SEED) == recording.path
    assert not (tmp_path / "own").exists()
