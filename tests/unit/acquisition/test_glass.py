"""Lenses of simulated cameras bend, lose light towards the corners and spread points: as they say, and only then."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acquisition.devices.open import Simulation, parse_devices
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from acquisition.scenes.glass import PERFECT, Glass, Pane, discrete_gaussian, spread
from acquisition.session.record import simulate
from reconstruction.images.pixels import estimate_pixels
from rigs.camera import Camera
from rigs.errors import Spike4dgsError
from rigs.exchange.nerfstudio import load_transforms
from rigs.toml import catalog_rig, load_rig
from rigs.transform import Transform

RIG = catalog_rig("ci3x3").only(["cam00", "cam01", "cam02"])
CAMERA = RIG.cameras[0]


def planes(path):
    return {name: (path / f"{name}.dat").read_bytes() for name in RIG.ids}


@pytest.mark.parametrize("percent", [10.0, 1.0, -8.0, 14.0])
def test_a_percentage_is_the_bend_at_the_corner(percent):
    bent = Glass(f"{percent:g}%").bent(RIG, 0).cameras[0]
    middle, corner = np.array([CAMERA.cx, CAMERA.cy]), np.array([[0.0, 0.0]])
    seen = bent.bent(corner)[0]
    np.testing.assert_allclose(seen - middle, (1 - percent / 100) * (corner[0] - middle), rtol=1e-12)
    assert np.isfinite(bent.slopes(corner)).all()


@pytest.mark.parametrize(
    ("text", "coefficients"),
    [
        ("-0.2,0.01", (-0.2, 0.01, 0.0, 0.0)),
        ("-.2, 1e-2, 0.001, -0.002", (-0.2, 0.01, 0.001, -0.002)),
        ("-0.2,0.01,0,0,0.003", (-0.2, 0.01, 0.0, 0.0, 0.003)),
    ],
)
def test_coefficients_are_opencvs(text, coefficients):
    assert Glass(text).bent(RIG, 0).cameras[1].distortion == coefficients


def test_lenses_differ_by_their_spread_and_by_the_seed_alone():
    rig = catalog_rig("lab3x3")
    plain = Glass("10%").bent(rig, 0).cameras[0].distortion[0]
    drawn = [[c.distortion[0] / plain for c in Glass("10%", 0.1).bent(rig, seed).cameras] for seed in (*range(40), 0)]
    assert drawn[0] == drawn[-1] != drawn[1]
    assert len(set(drawn[0])) == 9
    assert np.std(drawn) == pytest.approx(0.1, rel=0.1)
    assert np.mean(drawn) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"lens": "much"}, "found the lens 'much', expected 10%, or k1,k2"),
        ({"lens": "1,2,3"}, "found the lens '1,2,3'"),
        ({"lens": "nan,0"}, "found the lens 'nan,0'"),
        ({"lens": "1e400,0"}, "found distortion with NaN or infinity"),
        ({"lens": "15%"}, "found the lens 15%, expected -50% to 14%"),
        ({"lens_spread": 0.1}, "found lens_spread without a lens"),
        ({"vignetting": 0.95}, "found vignetting 0.95, expected 0 to 0.9"),
        ({"blur": -1.0}, "found blur -1.0, expected 0 to 5"),
        ({"blur": math.nan}, "found blur nan"),
    ],
)
def test_what_no_lens_has_is_refused(values, found):
    with pytest.raises(Spike4dgsError) as caught:
        Glass(**values)
    assert found in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_lens_that_folds_in_a_camera_is_refused_by_its_name():
    with pytest.raises(BadRecordingError, match="cam00: found a lens that folds inside the picture"):
        Glass("-3,0").bent(RIG, 0)
    with pytest.raises(BadRecordingError, match="folds inside"):
        Glass("14%", lens_spread=1.0).bent(catalog_rig("lab3x3"), 3)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_the_farthest_corner_loses_the_share(share):
    camera = Camera("a", 61, 43, 50.0, 60.0, 25.0, 20.0, Transform.identity())
    shares = Pane(camera, share, 0.0).shares.astype(np.float64)
    assert shares.mean() == pytest.approx(1, rel=1e-6)
    assert shares.min() == shares[-1, -1]
    wide = ((1 - share) ** -0.5 - 1) / (36.0**2 + 23.0**2)
    assert (1 + wide * (36.0**2 + 23.0**2)) ** -2 == pytest.approx(1 - share)
    found = shares[-1, -1] / shares[20, 25]  # the corner's pixel, and one half a pixel off the principal point
    assert found == pytest.approx(((1 + wide * (35.5**2 + 22.5**2)) / (1 + wide * 0.5)) ** -2, rel=1e-6)


@pytest.mark.parametrize("sd", [1e-9, 0.01, 0.3, 0.7, 1.0, 5.0])
def test_weights_of_a_blur_have_its_deviation_and_are_positive(sd):
    weights = discrete_gaussian(sd)
    places = np.arange(len(weights)) - len(weights) // 2
    assert weights.min() >= 0
    assert weights.sum() == pytest.approx(1, abs=1e-14)
    assert weights @ places**2 == pytest.approx(sd * sd, rel=2e-4, abs=1e-15)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-15)


def test_one_blur_after_another_is_one_of_both():
    light = np.random.default_rng(0).random((2, 40, 50))
    both = spread(spread(light, 0.6), 0.8)
    np.testing.assert_allclose(both[:, 9:-9, 9:-9], spread(light, 1.0)[:, 9:-9, 9:-9], atol=2e-5)


@given(n=st.integers(0, 2), h=st.integers(1, 9), w=st.integers(1, 17), sd=st.sampled_from([0.2, 1.0, 5.0]))
@settings(max_examples=30, deadline=None)
def test_even_light_stays_even_and_light_keeps_its_sum_inside(n, h, w, sd):
    np.testing.assert_allclose(spread(np.full((n, h, w), 0.5, np.float32), sd), 0.5, rtol=2e-6)
    reach = len(discrete_gaussian(sd)) // 2
    point = np.zeros((1, 2 * reach + h, 2 * reach + w))
    point[0, reach, reach] = 1.0
    seen = spread(point, sd)
    assert seen.sum() == pytest.approx(1, rel=1e-9)
    assert seen[0, reach, 0] == pytest.approx(discrete_gaussian(sd)[-1] * discrete_gaussian(sd)[reach])


def test_perfect_glass_changes_no_byte_of_recording_and_truth(tmp_path):
    assert PERFECT.bent(RIG, 1) is RIG
    assert PERFECT.pane(CAMERA) is None
    simulate(Simulation("fan_and_ball", 1), RIG, 8, tmp_path / "rec")
    assert load_rig(tmp_path / "rec/rig.toml").poses == RIG.poses
    assert not (tmp_path / "rec/truth/glass.json").exists()


def test_a_recording_passes_the_glass_and_its_truth_is_without_it(tmp_path):
    simulation = parse_devices("mock:fan_and_ball?seed=1&sensor=ideal&lens=8%&lens_spread=0.1&vignetting=0.4&blur=0.7")
    assert simulation == Simulation("fan_and_ball", 1, "ideal", glass=Glass("8%", 0.1, 0.4, 0.7))
    assert isinstance(simulation, Simulation)
    simulate(simulation, RIG, 60, tmp_path / "rec")
    simulate(Simulation("fan_and_ball", 1, "ideal", glass=Glass("8%", 0.1)), RIG, 60, tmp_path / "clear")
    truth, recording = tmp_path / "rec/truth", Recording.open(tmp_path / "rec")
    assert json.loads((truth / "glass.json").read_text()) == {
        "lens": "8%", "lens_spread": 0.1, "vignetting": 0.4, "blur": 0.7
    }  # fmt: skip
    assert recording.rig.poses == "nominal"
    assert not any(camera.bends for camera in recording.rig.cameras)
    seen = {camera.id: camera for camera in load_transforms(truth / "cameras.json")}
    for camera in Glass("8%", 0.1).bent(RIG, 1).cameras:
        assert seen[camera.id].lens == camera.lens
        shares = np.load(truth / camera.id / "vignetting.npy")
        light = np.load(truth / camera.id / "000020.npy")
        np.testing.assert_array_equal(light, np.load(tmp_path / "clear/truth" / camera.id / "000020.npy"))
        still = np.load(truth / camera.id / "000000.npy") == np.load(truth / camera.id / "000040.npy")
        still[:, -4:] = still[:, :4] = still[:4] = still[-4:] = False
        rate = recording.stream(camera.id).counts(0, 60) / 60
        assert still.mean() > 0.4
        off = np.abs(rate - shares * spread(light[None], 0.7)[0])[still]
        assert np.quantile(off, 0.9) < 1.2 / 60  # a spike, at most, and the light of rays elsewhere in the pixel
        assert np.quantile(np.abs(rate - light)[still], 0.9) > 2 / 60


def test_a_flat_takes_vignetting_into_the_gains_of_pixels(tmp_path):
    """Find the shares by `calibrate --pixels` behind such a lens, so that images and counts are without them."""
    glass, rig = Glass(vignetting=0.5), RIG.only(["cam00"])
    for scene in ("flat", "dark"):
        simulate(Simulation(scene, 2, truth_every=999, glass=glass), rig, 1000, tmp_path / scene)
    flat, dark = (Recording.open(tmp_path / name).stream("cam00") for name in ("flat", "dark"))
    shares = np.load(tmp_path / "flat/truth/cam00/vignetting.npy")
    maps = estimate_pixels(flat, dark)
    good = ~maps.defect
    assert good.mean() > 0.99
    assert np.std(maps.gain[good] / shares[good]) / np.mean(maps.gain[good] / shares[good]) < 0.012  # sensor: .008


def test_calibrated_cameras_keep_the_lenses_they_were_built_with(tmp_path):
    """A rig file with a found lens is what a recording states; its cameras have the one that they were given."""
    drawing = catalog_rig("ci3x3")
    simulation = Simulation("fan_and_ball", 5, glass=Glass("9%"), rig_error=1.0)
    simulate(simulation, drawing, 2, tmp_path / "first")
    assert load_rig(tmp_path / "first/rig.toml").poses == "nominal"
    built = simulation.built(drawing)
    assert all(camera.bends for camera in built.cameras)
    np.testing.assert_allclose(
        [c.center for c in built.cameras],
        [c.center for c in Simulation("flat", 5, rig_error=1.0).built(drawing).cameras],
    )
