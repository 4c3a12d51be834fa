"""The bend of lenses from an ordinary scene: found where it shows, left alone to the bit where not."""

from dataclasses import replace

import numpy as np
import pytest

from reconstruction.calibration.natural import calibrate_natural, with_focal
from reconstruction.calibration.natural_lens import lens_groups, lens_report, rebends, with_lens, with_lens_of
from reconstruction.calibration.problem import Loss, Observations, ScenePoints, State
from reconstruction.calibration.projection import Cameras, project
from reconstruction.pipeline.poses_stage import _with_shared_lens
from rigs.toml import catalog_rig
from tests.unit.reconstruction import test_natural_calibration as scenes

RIG = catalog_rig("lab3x3").only(scenes.FIVE)
NOISE_PX = 0.1
PINHOLE = (0.0, 0.0, 0.0, 0.0)


def bent(rig, *distortion, **more):
    return replace(rig, cameras=tuple(replace(c, distortion=distortion, **more) for c in rig.cameras))


def adjusted(true, assumed, depths_m=(1.3, 3.0), noise_px=NOISE_PX):
    """Return the cameras by points that `true` lenses show with noise, adjusted with the lenses of `assumed`."""
    rng, count, points = np.random.default_rng(4), len(true.cameras), 150
    across = rng.uniform((-1.2, -0.8), (1.2, 0.8), (points, 2))
    scene = np.insert(across, 2, rng.uniform(*depths_m, points), axis=1)
    camera, block = np.repeat(np.arange(count), points), np.tile(np.arange(points), count)
    pixels = project(scene[block], Cameras.of(true.cameras), camera).pixels
    inside = ((pixels > 0) & (pixels < (RIG.cameras[0].width, RIG.cameras[0].height))).all(axis=1)
    noisy = pixels + rng.normal(0, noise_px, pixels.shape)
    observations = Observations(camera[inside], block[inside], noisy[inside], np.full(int(inside.sum()), NOISE_PX))
    state = State(Cameras.of(assumed.cameras), ScenePoints(scene), np.zeros(6 * count))
    return with_focal(state, observations, Loss("cauchy", 30.0))


@pytest.mark.parametrize("depths_m", [(1.3, 3.0), (2.0, 2.0)])
def test_a_pinhole_stays_the_very_solution_it_was(depths_m):
    before = adjusted(RIG, RIG, depths_m)
    assert with_lens(before) is before
    assert lens_groups(before) == ()
    assert not rebends(before)
    assert lens_report(before, RIG, RIG) == {"distortion": "as in the rig file: the scene shows no other"}
    assert with_lens_of(RIG, before).cameras[0].distortion == PINHOLE


@pytest.mark.parametrize(
    ("true", "assumed", "groups"),
    [
        ((-0.22, 0.0, 0.0, 0.0), PINHOLE, ("k1",)),
        ((-0.22, 0.12, 0.0, 0.0), PINHOLE, ("k1", "k2")),
        ((0.08, 0.0, 0.0, 0.0), (0.05, 0.0, 0.0, 0.0), ("k1",)),
        ((-0.22, 0.05, 0.0, 0.0), (-0.22, 0.05, 0.0, 0.0), ()),
    ],
)
def test_a_lens_that_the_rig_file_lacks_is_found_as_well_as_it_says(true, assumed, groups):
    found = with_lens(adjusted(bent(RIG, *true), bent(RIG, *assumed)))
    assert lens_groups(found) == groups
    cameras = found.state.cameras.written_to(bent(RIG, *assumed))
    report = lens_report(found, cameras, bent(RIG, *assumed))
    for at, name in enumerate(groups):
        assert report[f"{name}_sd"] < 0.015
        assert abs(cameras.cameras[0].distortion[at] - true[at]) < 4 * report[f"{name}_sd"]
        assert report[f"{name}_change"] == pytest.approx(true[at] - assumed[at], abs=4 * report[f"{name}_sd"])
    for at in range(len(groups), 4):
        assert cameras.cameras[0].distortion[at] == assumed[at]


def test_a_lens_drowned_in_noise_is_left_alone():
    assert lens_groups(with_lens(adjusted(bent(RIG, -0.05, 0, 0, 0), RIG))) == ("k1",)
    drowned = adjusted(bent(RIG, -0.05, 0, 0, 0), RIG, noise_px=3.0)
    assert with_lens(drowned) is drowned


def test_lenses_of_two_models_have_no_bend_in_common():
    true = bent(RIG, -0.22, 0, 0, 0)
    mixed = replace(RIG, cameras=(replace(RIG.cameras[0], lens_model="fisheye"), *RIG.cameras[1:]))
    before = adjusted(true, mixed)
    assert with_lens(before) is before


def test_a_fisheyes_own_bend_is_found():
    assumed = bent(RIG, *PINHOLE, lens_model="fisheye")
    found = with_lens(adjusted(bent(assumed, -0.1, 0, 0, 0), assumed))
    assert found.moved("k1") == pytest.approx(-0.1, abs=0.02)


def test_cameras_that_were_not_looked_at_take_what_the_others_have_in_common():
    views = RIG.ids[:4]
    found = replace(RIG, cameras=tuple(bent(RIG, -0.2, 0, 0, 0).cameras[:4] + RIG.cameras[4:]))
    assert _with_shared_lens(found, RIG, views).camera("cam22").distortion == (-0.2, 0, 0, 0)
    assert _with_shared_lens(RIG, RIG, views).camera("cam22").distortion is RIG.camera("cam22").distortion


@pytest.mark.slow
def test_pictures_through_a_lens_give_it_from_a_rig_file_without_it(monkeypatch):
    monkeypatch.setattr(scenes, "RIG", bent(scenes.RIG, -0.22, 0, 0, 0))
    images = scenes.pictures(scenes.wall(0), *scenes.blocks(np.random.default_rng(9)), views=scenes.FIVE)
    found = calibrate_natural(bent(scenes.misplaced(scenes.RIG, 2, 0), *PINHOLE), images, scenes.DATE)
    off = scenes.errors_of(found, images)
    assert off.rotation_deg < 0.02
    assert off.focal_percent < 0.2
    assert found.rig.camera("cam11").distortion[0] == pytest.approx(-0.22, abs=0.002)
    assert found.report["k1_sd"] < 0.002
    assert found.report["kept_share"] > 0.95
