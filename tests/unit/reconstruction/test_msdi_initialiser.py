from dataclasses import replace

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.scenes.misplaced import misplaced
from acquisition.scenes.random.several_views import multiview_scene, random_rig
from acquisition.spikes.sensor import Sensor
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.images.catalogue import method
from reconstruction.images.methods.adaptive import adaptive
from reconstruction.initialization.msdi import LEAST_CONFIDENCE, initialise
from reconstruction.metrics.image import psnr_db
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.rates import REACH
from reconstruction.networks.training.clips import MultiviewClips, exposed
from rigs.similarity import align

CLIP = MultiviewClips(first_seed=910_002, count=1)


@pytest.fixture(scope="module")
def clip():
    return CLIP.make(CLIP.first_seed)


@pytest.fixture(scope="module")
def streams(clip):
    return dict(zip(clip.rig.ids, clip.streams, strict=True))


@pytest.fixture(scope="module")
def nominal(clip):
    return misplaced(clip.rig, 2.0, 4)


@pytest.fixture(scope="module")
def found(clip, streams, nominal):
    told = []
    geometry = initialise(streams, nominal, clip.rig.clock.instant_s(clip.plane), lambda f, m: told.append(f))
    assert told == sorted(told)
    assert 0 <= told[0] <= told[-1] <= 1
    return geometry


def dark(stream, share=0.0):
    """The stream with a share of its bytes of eight pixels only."""
    kept = np.random.default_rng(0).random(stream.packed.shape) < share
    return SpikeStream(np.where(kept, stream.packed, 0).astype(np.uint8), stream.layout, stream.tick_rate_hz)


def test_the_shipped_weights_leave_a_quarter_of_the_nominal_error(clip, nominal, found):
    before, after = (pose_errors(rig, clip.rig, 1.8) for rig in (nominal, found.rig))
    assert after.rotation_deg < before.rotation_deg / 4
    assert found.rig.ids == nominal.ids
    assert align(found.rig, nominal).scale == pytest.approx(1, abs=1e-6)


def test_points_lie_on_what_the_views_see(clip, found):
    assert found.points.shape == (len(found.confidence), 3)
    assert len(found.points) > 3000
    assert found.confidence.min() >= LEAST_CONFIDENCE
    in_truth = align(found.rig, clip.rig).apply(found.points)
    camera, depth = clip.rig.cameras[0], clip.depth[0]
    there = camera.cam_from_rig.apply(in_truth)
    at = (there[:, :2] / there[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)).astype(int)
    inside = ((at >= 0) & (at < (camera.width, camera.height))).all(axis=1)
    true = depth[at[inside, 1], at[inside, 0]]
    error = np.abs(there[inside, 2] / true - 1)
    assert np.median(error) < 0.05


def test_images_are_better_than_the_best_without_learning(clip, streams):
    for v, stream in enumerate(streams.values()):
        learnt, plain = method("msdi")(stream, clip.plane).intensity, adaptive(stream, clip.plane).intensity
        assert psnr_db(learnt, clip.light[v], clip.white) > psnr_db(plain, clip.light[v], clip.white)


def test_an_image_knows_where_it_is_sure(clip, streams):
    estimate = method("msdi")(streams[clip.rig.ids[1]], clip.plane)
    assert estimate.valid.mean() > 0.9
    assert (estimate.sigma > 0).all()


def test_a_dark_view_keeps_its_nominal_pose_and_the_others_are_found(clip, streams, nominal):
    last = clip.rig.ids[-1]
    geometry = initialise({**streams, last: dark(streams[last], 0.02)}, nominal, clip.rig.clock.instant_s(clip.plane))
    assert geometry.report["dark"] == [last]
    kept = geometry.rig.camera(last).cam_from_rig.matrix
    assert np.array_equal(kept, nominal.camera(last).cam_from_rig.matrix)
    others = clip.rig.only(clip.rig.ids[:-1])
    before, after = (pose_errors(rig.only(others.ids), others, 1.8) for rig in (nominal, geometry.rig))
    assert after.rotation_deg < before.rotation_deg / 2


def test_too_little_light_is_refused(clip, streams, nominal):
    darkened = {name: dark(stream) for name, stream in streams.items()}
    with pytest.raises(GeometryError, match="0 views with light"):
        initialise(darkened, nominal, clip.rig.clock.instant_s(clip.plane))


def test_views_of_different_scenes_are_not_believed(clip, streams, nominal):
    """Noise in place of one view: its correspondences do not agree with any camera."""
    name = clip.rig.ids[0]
    noise = np.random.default_rng(0).integers(0, 256, streams[name].packed.shape, dtype=np.uint8)
    other = SpikeStream(noise, streams[name].layout, streams[name].tick_rate_hz)
    with pytest.raises(GeometryError, match="correspondences"):
        initialise({**streams, name: other}, nominal, clip.rig.clock.instant_s(clip.plane))


def test_lenses_that_bend_each_their_own_way_cost_little():
    """Views are pinholes that cover the pictures: poses are found as well as without lenses, points lie as near."""
    plain, planes = random_rig(CLIP.first_seed, 3, 160, 104), 2 * REACH + 1
    corner = np.hypot(80, 52) / plain.cameras[0].fx
    bends = (0.0, 0.1, 0.12)  # at the corners; one lens does not bend
    lenses = [(-bend / corner**2, 0.0, 0.0, 0.0) for bend in bends]
    pairs = zip(plain.cameras, lenses, strict=True)
    rig = replace(plain, cameras=tuple(replace(c, cx=80.0, cy=52.0, distortion=k) for c, k in pairs))
    instant_s = rig.clock.instant_s(REACH)
    scene = multiview_scene(CLIP.first_seed, rig.cameras[0].fx, instant_s)
    sensors = [Sensor(camera.width, camera.height, "real", 1, n) for n, camera in enumerate(rig.cameras)]
    pairs = zip(rig.cameras, sensors, strict=True)
    streams = {camera.id: exposed(scene, camera, rig.clock, planes, sensor) for camera, sensor in pairs}
    nominal = misplaced(rig, 2.0, 4)
    found = initialise(streams, nominal, instant_s)
    before, after = (pose_errors(one, rig, 1.8) for one in (nominal, found.rig))
    assert after.rotation_deg < before.rotation_deg / 20  # to .06 degrees
    assert [camera.lens for camera in found.rig.cameras] == [camera.lens for camera in rig.cameras]
    assert [camera.cx for camera in found.rig.cameras] == [camera.cx for camera in nominal.cameras]
    camera, points = rig.cameras[1], align(found.rig, rig).apply(found.points)
    pixels, inside = camera.project(points)
    true = scene.render(camera, np.array([instant_s]), 1).depth[0][tuple(pixels[inside].astype(int).T[::-1])]
    assert np.median(np.abs(camera.cam_from_rig.apply(points)[inside, 2] / true - 1)) < 0.05
    assert inside.mean() > 0.6


def test_what_cannot_be_is_refused_by_name(clip, streams, nominal, tmp_path):
    instant_s = clip.rig.clock.instant_s(clip.plane)
    two = dict(list(streams.items())[:2])
    with pytest.raises(BadRunError, match="2 views, expected 3 to 9"):
        initialise(two, nominal, instant_s)
    with pytest.raises(BadRunError, match="streams of camXY"):
        initialise({**streams, "camXY": clip.streams[0]}, nominal, instant_s)
    with pytest.raises(BadRunError, match="one size"):
        initialise(streams, nominal.scaled(96, 64), instant_s)
    with pytest.raises(BadRecordingError, match="expected one inside"):
        initialise(streams, nominal, 1.0)
    with pytest.raises(BadRunError, match="no weights"):
        initialise(streams, nominal, instant_s, weights=tmp_path / "none.npz")
    (tmp_path / "junk.npz").write_bytes(b"junk")
    with pytest.raises(BadRunError, match="other or damaged weights"):
        initialise(streams, nominal, instant_s, weights=tmp_path / "junk.npz")
