"""The evidence of training views, and the errors that are expected from it."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from reconstruction.errors import BadRunError
from reconstruction.evaluation.expectation import block_means, rank_correlation
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.rendering.render import render
from reconstruction.report.video import trusted_share
from reconstruction.run.spans import Span
from reconstruction.scene_model import TimeSpan
from reconstruction.uncertainty.evidence import Evidence, SceneEvidence, gather
from reconstruction.uncertainty.expected_error import FARTHEST, NARROWEST_RAD, WEIGHTS, Uncertainty
from rigs.clock import RigClock
from rigs.transform import Transform

CLOCK = RigClock(20000.0, 40)
SPAN = Span(0, 200)


@dataclass
class Source:
    """Target images that are off the renders by `error`, in `rows` of them alone."""

    scene: object
    camera: object
    error: float = 0.0
    rows: tuple[int, int] = (0, 999)
    straightening: object = None

    @property
    def moving(self):
        return np.zeros((self.camera.height, self.camera.width), bool)

    def at(self, plane):
        image = self.scene.look(self.camera, CLOCK.instant_s(plane)).intensity.copy()
        image[slice(*self.rows)] += self.error
        return image


def views_of(scene, **options):
    cameras = [camera for camera in scene.rig.cameras if camera.id != scene.holdout]
    return {camera.id: (camera, Source(scene.cloud, camera, **options)) for camera in cameras}


def told(scene, **options) -> Uncertainty:
    return Uncertainty(scene.cloud, gather(scene.cloud, views_of(scene, **options), CLOCK, [SPAN], scene.white))


def test_a_misfit_is_that_of_the_pixels_a_gaussian_fills(one_scene):
    scene = replace(one_scene, holdout="cam01")
    for error in (0.0, 0.1, 40.0):
        evidence = told(scene, error=error).evidence
        expected = (error / scene.white) ** 2
        assert float(evidence.still.misfit[0]) == pytest.approx(expected, rel=1e-4, abs=1e-12)
        assert evidence.still.seen.tolist() == [[True, True]]
        assert len(evidence.movers[0].misfit) == 0


def test_a_misfit_where_a_gaussian_is_not_is_not_its_own(scene_with):
    scene = scene_with("linear", still=60, moving=10)
    half = told(scene, error=0.2, rows=(0, 20)).evidence.at(0)
    middle = scene.cloud.at(scene.cloud.clip.middle_s).means[:, 1]
    above, below = (float(half.misfit[pixels].mean()) for pixels in (middle < -0.2, middle > 0.25))
    assert above > 5 * below > 0


def test_what_nobody_sees_has_the_mean_misfit(scene_with):
    scene = scene_with("linear", still=30, moving=0)
    scene.cloud.still.means[0] = torch.tensor([0.0, 0.0, -5.0])
    evidence = told(scene, error=0.2).evidence
    assert not evidence.still.seen[0].any()
    assert float(evidence.still.misfit[0]) == pytest.approx((0.2 / scene.white) ** 2, rel=1e-4)


def spanned_of(scene) -> SpannedScene:
    """Movers, then nothing of its own, then movers again."""
    ends = [(0.002, 0.005), (0.005, 0.008), (0.008, 0.012)]
    movers = DynamicCloud(scene.cloud.still.select(torch.zeros(0, dtype=torch.int64)), *moving_of(scene))
    contents = [SpanContent.as_usual(TimeSpan(*end)) for end in ends]
    for number in (0, 2):
        contents[number].cloud = movers
    return SpannedScene(scene.cloud.still, contents, TimeSpan(0.002, 0.012))


def moving_of(scene):
    return scene.cloud.moving, scene.cloud.motion, scene.cloud.clip


def test_spans_have_evidence_of_their_own_and_resting_ones_are_left_out(scene_with):
    scene = scene_with("linear", still=30, moving=8)
    scene = replace(scene, cloud=spanned_of(scene))
    looked = []
    views = views_of(scene, error=0.1)
    for _, source in views.values():
        source.at = lambda plane, own=source: looked.append(plane) or Source.at(own, plane)
    spans = [Span(0, 60), Span(60, 120), Span(120, 200)]
    evidence = gather(scene.cloud, views, CLOCK, spans, scene.white)
    assert [len(found.misfit) for found in evidence.movers] == [8, 0, 8]
    assert len(evidence.at(0).misfit) == 38
    assert sorted(set(looked)) == [15, 45, 140, 180]


def test_where_nothing_moves_one_span_is_looked_at(scene_with):
    scene = scene_with("linear", still=30, moving=0)
    resting = [SpanContent.as_usual(TimeSpan(0.001 * i, 0.001 * i + 0.001)) for i in range(3)]
    scene = replace(scene, cloud=SpannedScene(scene.cloud.still, resting, TimeSpan(0.0, 0.003)))
    spans = [Span(20 * i, 20 * i + 20) for i in range(3)]
    evidence = gather(scene.cloud, views_of(scene, error=0.1), CLOCK, spans, scene.white)
    assert evidence.still.seen.any()
    assert float(evidence.still.misfit.max()) == pytest.approx((0.1 / scene.white) ** 2, rel=1e-3)


def test_evidence_is_kept_to_a_thousandth(scene_with):
    evidence = told(scene_with("linear"), error=0.01).evidence
    kept = SceneEvidence.from_state(evidence.state())
    for own, other in zip((evidence.still, *evidence.movers), (kept.still, *kept.movers), strict=True):
        torch.testing.assert_close(other.misfit, own.misfit, rtol=2e-3, atol=1e-9)
        assert torch.equal(other.seen, own.seen)
    assert kept.white == evidence.white
    assert torch.equal(kept.centres, evidence.centres)


@pytest.mark.parametrize("lacking", ["still", "movers", "centres", "white", "void"])
def test_other_content_is_refused_in_one_line(scene_with, lacking):
    state = told(scene_with("linear")).evidence.state()
    with pytest.raises(BadRunError, match="run the report stage again"):
        SceneEvidence.from_state({name: value for name, value in state.items() if name != lacking})


def test_the_expected_error_is_the_root_of_weighted_terms(scene_with):
    scene = scene_with("linear")
    uncertainty, camera, at_s = told(scene, error=0.05), scene.rig.camera("cam01"), scene.cloud.clip.middle_s
    terms = uncertainty.terms(camera, at_s).double().numpy()
    expected = scene.white * np.sqrt(np.tensordot(np.array(list(WEIGHTS.values())), terms, 1))
    np.testing.assert_allclose(uncertainty.look(camera, at_s), expected, rtol=1e-5)
    assert (terms >= 0).all()
    assert len(terms) == len(WEIGHTS)


def test_the_terms_of_a_lone_gaussian_are_those_of_its_misfit_breadth_and_leverage(one_scene):
    uncertainty = told(replace(one_scene, holdout="cam01"), error=0.1)
    camera = one_scene.rig.camera("cam01")
    now = one_scene.cloud.at(0.007)
    misfit, _, holes, misfit_out, light_out, holes_out = uncertainty.terms(camera, 0.007)
    alpha = render(now, camera).alpha
    seers = [one_scene.rig.camera(name) for name in ("cam00", "cam02")]  # cam01 itself is held out
    own, *seers = [c.center - now.means[0].numpy() for c in (camera, *seers)]
    breadth, square = 0.06 / float(np.linalg.norm(own)), (0.1 / one_scene.white) ** 2
    out, void = alpha * leverage_of(own, seers), uncertainty.evidence.void
    torch.testing.assert_close(misfit, alpha * square, rtol=1e-3, atol=1e-7)
    torch.testing.assert_close(holes, (1 - alpha) * void, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(misfit_out, out * square * breadth, rtol=1e-3, atol=1e-7)
    torch.testing.assert_close(light_out, alpha**2 * out, rtol=1e-3, atol=1e-6)
    torch.testing.assert_close(holes_out, (1 - alpha) * out * void, rtol=1e-3, atol=1e-6)


def leverage_of(own, seers) -> float:
    """Return the leverage of one way among others in float64, solved as it is written."""
    own, *seers = (way.astype(float) / np.linalg.norm(way) for way in (own, *seers))
    apart = np.array(seers) - np.mean(seers, axis=0)
    off = own - np.mean(seers, axis=0)
    leverage = off @ np.linalg.solve(apart.T @ apart + NARROWEST_RAD**2 * np.eye(3), off)
    return float(leverage / (1 + leverage / FARTHEST))


def test_the_leverage_is_that_of_the_solved_equations(scene_with):
    scene = scene_with("linear", still=200, moving=0)
    uncertainty, camera = told(scene), scene.rig.camera("cam01")
    now, known = scene.cloud.at(0.007), uncertainty.evidence.at(0)
    away = torch.tensor(camera.center).float() - now.means
    found = uncertainty._outside(now, away, known)
    for number, seen in enumerate(known.seen):
        seers = (uncertainty.evidence.centres[seen] - now.means[number]).numpy()
        wanted = leverage_of(away[number].numpy(), seers) if len(seers) else FARTHEST
        assert float(found[number]) == pytest.approx(wanted, rel=1e-3, abs=1e-5)


def test_holes_that_the_views_have_seen_are_no_errors(scene_with):
    scene = scene_with("linear", still=20, moving=0)
    seen, filled = told(scene, error=0.0).evidence.void, told(scene, error=scene.white).evidence.void
    assert seen < 0.01
    assert filled == pytest.approx(1, abs=0.1)


def test_away_from_the_cameras_more_is_expected(one_scene):
    uncertainty, camera = told(replace(one_scene, holdout="cam01"), error=0.05), one_scene.rig.camera("cam01")
    target, peaks = (0.2, -0.1, 2.2), []
    for far in (0.0, 0.4, 0.8, 1.6):
        camera = replace(camera, cam_from_rig=Transform.looking_at((0.35 + far, 0.05, -0.1), target, (0.2, 1.0, 0)))
        seen = render(one_scene.cloud.at(0.007), camera)
        peaks.append(float(uncertainty.look(camera, 0.007).flat[int(seen.alpha.argmax())]))
    assert peaks == sorted(peaks)
    assert peaks[-1] > 2 * peaks[0]


@pytest.mark.parametrize(("steepness", "share"), [(0.0, 0.8), (4.0, 0.6), (1e3, 0.2)])
def test_the_orbit_is_as_wide_as_its_pictures_are_trusted(one_scene, monkeypatch, steepness, share):
    uncertainty, middle = told(replace(one_scene, holdout="cam01")), one_scene.rig.camera("cam01")

    def look(camera, _):
        return np.full((2, 2), 1 + steepness * np.linalg.norm(camera.center - middle.center), np.float32)

    monkeypatch.setattr(Uncertainty, "look", lambda _, camera, at_s: look(camera, at_s))
    assert trusted_share(uncertainty, one_scene.rig, middle) == share


def test_nothing_at_all_is_expected_to_be_a_hole(empty_scene):
    scene = replace(empty_scene, holdout="cam01")
    expected = told(scene, error=0.1).look(scene.rig.camera("cam01"), 0.007)
    void = told(scene, error=0.1).evidence.void
    np.testing.assert_allclose(expected, scene.white * math.sqrt(WEIGHTS["holes"] * void), rtol=1e-5)
    assert void == pytest.approx((0.1 / scene.white) ** 2, rel=1e-3)


@pytest.mark.parametrize("misfit", [0.0, 1e-12, 1.0, 1e6])
@pytest.mark.parametrize("depth_m", [0.011, 2.0, 1e6])
def test_the_expected_error_is_finite_for_extreme_scenes(scene_with, misfit, depth_m):
    scene = scene_with("linear", still=12, moving=3)
    scene.cloud.still.means[:, 2] = depth_m
    scene.cloud.still.log_scales[:6] = 30.0
    count, none = 12, torch.zeros(3, 2, dtype=torch.bool)
    still = Evidence(torch.full((count,), misfit), torch.zeros(count, 2, dtype=torch.bool))
    centres = torch.tensor(scene.rig.camera("cam00").center).float().repeat(2, 1)
    centres[1] = scene.cloud.still.means[0]  # a camera within a Gaussian
    evidence = SceneEvidence(still, [Evidence(torch.full((3,), misfit), none)], centres, scene.white, 1.0)
    expected = Uncertainty(scene.cloud, evidence).look(scene.rig.camera("cam01"), 0.007)
    assert np.isfinite(expected).all()
    assert (expected >= 0).all()


def test_a_lens_that_bends_bends_the_expected_error(scene_with):
    scene = scene_with("linear")
    camera, uncertainty = scene.rig.camera("cam01"), told(scene, error=0.1)
    bent = uncertainty.look(replace(camera, distortion=(-0.1, 0.0, 0.0, 0.0)), 0.007)
    straight = uncertainty.look(camera, 0.007)
    assert bent.shape == straight.shape
    middle = (slice(18, 23), slice(30, 36))
    np.testing.assert_allclose(bent[middle].mean(), straight[middle].mean(), rtol=0.05)
    assert not np.array_equal(bent, straight)


@pytest.mark.parametrize("shape", [(1, 1), (16, 16), (33, 40), (5, 70)])
def test_blocks_are_means_of_whole_blocks(shape):
    image = np.random.default_rng(1).random(shape)
    means = block_means(image)
    rows, columns = max(1, shape[0] // 16), max(1, shape[1] // 16)
    assert means.shape == (rows, columns)
    assert means[0, 0] == pytest.approx(image[: min(16, shape[0]), : min(16, shape[1])].mean())
    assert means[-1, -1] == pytest.approx(image[16 * (rows - 1) : 16 * rows, 16 * (columns - 1) : 16 * columns].mean())


def test_ranks_ignore_any_rising_function():
    values = np.random.default_rng(2).random((6, 7))
    assert rank_correlation(values, np.exp(5 * values)) == pytest.approx(1)
    assert rank_correlation(values, -values) == pytest.approx(-1)
    assert abs(rank_correlation(values, np.random.default_rng(3).random((6, 7)))) < 0.4
    assert math.isnan(rank_correlation(values, np.ones((6, 7))))


def test_ranks_that_are_shared_agree_on_nothing():
    values = np.random.default_rng(4).random(30)
    assert abs(rank_correlation(np.r_[np.zeros(970), values], np.r_[values, np.zeros(970)])) < 0.05
    assert rank_correlation(np.array([1.0, 1, 2, 3]), np.array([5.0, 6, 7, 8])) == pytest.approx(4.5 / 22.5**0.5)
