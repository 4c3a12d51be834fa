import dataclasses
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.catalogue import price_s
from reconstruction.methods.catalogue import METHODS
from reconstruction.methods.definition import SWEEPS
from reconstruction.run.configuration import CHOICES, ReconstructionConfig
from reconstruction.run.decisions import Plan
from reconstruction.run.plan import STILL_ONCE, _choose_sizes, make_plan
from reconstruction.run.prices import Work
from rigs.errors import RigError
from rigs.toml import catalog_rig

RIG = catalog_rig("ci3x3").scaled(40, 26)


def streams(moving=False, dark=()):
    layout = PlaneLayout(40, 26)
    found = {}
    for i, camera in enumerate(RIG.ids):
        spikes = np.zeros((160, 26, 40), np.uint8)
        if camera not in dark:
            phase = np.random.default_rng(i).integers(0, 3, (26, 40))
            spikes[:] = (np.arange(160)[:, None, None] + phase) % 3 == 0
            if moving:
                spikes[40:80, 5:13, 5:13] = 1
        found[camera] = SpikeStream(pack(spikes, layout), layout, 20000.0)
    return found


def dim_streams(every):
    """Return streams that fire once in `every` planes, a mover's pixels twice as often."""
    layout, found = PlaneLayout(40, 26), {}
    ticks = np.arange(400)[:, None, None]
    for i, camera in enumerate(RIG.ids):
        phase = np.random.default_rng(i).integers(0, every, (26, 40))
        spikes = ((ticks + phase) % every == 0).astype(np.uint8)
        spikes[200:, 5:20, 5:20] |= ((ticks[200:] + phase[5:20, 5:20] + every // 2) % every == 0).astype(np.uint8)
        found[camera] = SpikeStream(pack(spikes, layout), layout, 20000.0)
    return found


@pytest.mark.parametrize(
    ("every", "rate_hz", "planes"),
    [(3, 20000.0, 9), (3, 10000.0, 9), (3, 5000.0, 7), (3, 2000.0, 7), (3, 100.0, 7), (60, 20000.0, 17), (60, 1e4, 9)],
)
def test_windows_follow_spikes_and_the_plane_rate(every, rate_hz, planes):
    rig = dataclasses.replace(RIG, tick_rate_hz=rate_hz)
    plan, _, _ = make_plan(ReconstructionConfig(), rig, dim_streams(every))
    assert plan.window == planes
    (said,) = (d for d in plan.decisions if d.about == "windows")
    assert (said.choice, said.override) == (f"{planes} planes", "--window")
    assert make_plan(ReconstructionConfig(window=5), rig, dim_streams(every))[0].window == 5
    assert [d.about == "few spikes" for d in plan.decisions].count(True) == (every == 60)


@pytest.mark.parametrize("window", [0, -3, 4])
def test_a_window_that_has_no_middle_is_refused(window):
    with pytest.raises(BadRunError, match="an odd number from 1"):
        ReconstructionConfig(window=window)


class Untouchable(dict):
    """Streams that tell when the held-out one is read."""

    def __getitem__(self, key):
        assert key != "cam11", "the held-out camera was read"
        return super().__getitem__(key)


def test_a_still_scene_gets_no_motion_model_and_says_why():
    told: list[float] = []
    plan, masks, _ = make_plan(ReconstructionConfig(), RIG, streams(), lambda fraction, _: told.append(fraction))
    assert told == sorted(told)
    assert len(told) == 1 + len(masks)
    assert told[-1] < 1
    assert plan.model == "static"
    assert plan.moving_gaussians == 0
    assert plan.supervision == "pixels"
    assert not any(mask.any() for mask in masks.values())
    assert any(d.about == "motion" and "0.00%" in d.reason for d in plan.decisions)


def test_a_moving_scene_gets_one():
    plan, masks, _ = make_plan(ReconstructionConfig(), RIG, streams(moving=True))
    assert plan.model == "bases"
    assert plan.supervision == "pixels"
    assert plan.moving_gaussians + plan.still_gaussians == 2 * 40 * 26  # two for every pixel
    assert masks["cam00"].shape == (1, 26, 40)
    assert masks["cam00"][0, 10, 10]
    assert not masks["cam00"][0, 24, 38]


def test_overrides_are_obeyed():
    config = ReconstructionConfig(model="static", images="tfi", supervision="image-variation", views=("cam00", "cam01"))
    plan, masks, _ = make_plan(config, RIG, streams(moving=True))
    assert (plan.model, plan.images, plan.supervision) == ("static", "tfi", "image-variation")
    assert plan.views == ("cam00", "cam01")
    assert not masks["cam00"].any()


def test_the_held_out_camera_is_neither_used_nor_read():
    plan, _, _ = make_plan(ReconstructionConfig(holdout="cam11"), RIG, Untouchable(streams()))
    assert "cam11" not in plan.views
    assert len(plan.views) == 8


def test_a_dark_view_is_skipped_and_named():
    plan, _, _ = make_plan(ReconstructionConfig(), RIG, streams(dark=("cam20",)))
    assert "cam20" not in plan.views
    assert any("cam20 skipped" in d.choice for d in plan.decisions)


def test_a_dark_view_that_is_named_is_kept():
    config = ReconstructionConfig(views=("cam00", "cam20", "cam22"))
    plan, _, _ = make_plan(config, RIG, streams(dark=("cam20",)))
    assert plan.views == ("cam00", "cam20", "cam22")
    assert not any(d.about == "views" for d in plan.decisions)


@pytest.mark.parametrize("images", CHOICES["images"])
def test_every_choice_of_images_has_a_price(images):
    plan, _, _ = make_plan(ReconstructionConfig(images=images), RIG, streams(moving=True))
    assert plan.images == ("interpolated" if images == "auto" else images)


def test_one_stream_under_two_names_is_refused_by_name():
    found = streams()
    found["cam12"] = found["cam01"]
    with pytest.raises(BadRunError, match="the same spikes in cam01 and cam12, expected one stream a camera"):
        make_plan(ReconstructionConfig(), RIG, found)
    plan, _, _ = make_plan(ReconstructionConfig(holdout="cam12"), RIG, found)
    assert len(plan.views) == 8


def test_two_dark_views_are_no_twins():
    plan, _, _ = make_plan(ReconstructionConfig(), RIG, streams(dark=("cam20", "cam00")))
    assert len(plan.views) == 7


def test_no_light_at_all_is_refused():
    with pytest.raises(BadRunError, match="found 0 training views with light"):
        make_plan(ReconstructionConfig(), RIG, streams(dark=RIG.ids))


def test_unknown_cameras_are_refused_by_name():
    with pytest.raises(RigError, match="cam77"):
        make_plan(ReconstructionConfig(holdout="cam77"), RIG, streams())


def test_the_plan_round_trips_through_json():
    plan, _, _ = make_plan(ReconstructionConfig(), RIG, streams(moving=True))
    assert Plan.from_json(dataclasses.asdict(plan)) == plan
    assert Plan.from_json(dataclasses.asdict(plan) | {"half_until": 0.1}) == plan  # as revisions before 0.9 wrote it


def about(plan, what):
    return next(d for d in plan.decisions if d.about == what)


def test_maps_of_pixels_are_read_where_they_are_there(tmp_path):
    none = about(make_plan(ReconstructionConfig(), RIG, streams())[0], "pixels")
    assert (none.choice, none.override) == ("taken as even", "--pixels")
    assert "calibrate --pixels" in none.reason
    mapped = dataclasses.replace(
        RIG, cameras=tuple(dataclasses.replace(c, pixels=tmp_path) for c in RIG.cameras[:3]) + RIG.cameras[3:]
    )
    plan, _, _ = make_plan(ReconstructionConfig(), mapped, streams())
    assert plan.pixels == "maps"
    assert "3 of 9 views" in about(plan, "pixels").reason
    plan, _, _ = make_plan(ReconstructionConfig(pixels="even"), mapped, streams())
    assert plan.pixels == "even"
    with pytest.raises(BadRunError, match="found --pixels maps and no map"):
        make_plan(ReconstructionConfig(pixels="maps"), RIG, streams())


def test_what_is_left_out_says_what_it_saves():
    plan, _, _ = make_plan(ReconstructionConfig(budget_s=None, steps=1000), RIG, streams())
    assert about(plan, "supervision").saves_s == pytest.approx(
        0.884 * 1000 * (6.7e-7 * 2080 + 0.00642 * 40 * 26 / 1e5), rel=1e-3
    )
    assert about(plan, "colour").saves_bytes == 47 * 3 * 4 * 2080
    assert about(plan, "motion").saves_s > 0
    assert about(plan, "poses").saves_s > 0
    assert about(plan, "pixels").saves_s is None
    assert "saves" in str(about(plan, "motion"))
    assert "saves" not in str(about(plan, "pixels"))
    assert {d.about for d in plan.decisions} >= {"instants", "Gaussians", "pixels"}


def test_poses_are_found_where_they_are_nominal_alone():
    nominal = dataclasses.replace(RIG, poses="nominal")
    assert make_plan(ReconstructionConfig(), RIG, streams())[0].init == "sweep"
    assert make_plan(ReconstructionConfig(), nominal, streams())[0].init == "natural"
    assert make_plan(ReconstructionConfig(init="sweep"), nominal, streams())[0].init == "sweep"


def test_twice_the_steps_save_twice_the_seconds():
    found = [make_plan(ReconstructionConfig(budget_s=None, steps=n), RIG, streams())[0] for n in (500, 1000)]
    once, twice = (about(plan, "Gaussians").saves_s for plan in found)
    assert twice == pytest.approx(2 * once)


def test_a_wider_stride_saves_images_of_movers_alone():
    config = ReconstructionConfig(tick_stride=8)
    still, moving = (make_plan(config, RIG, streams(moving=m))[0] for m in (False, True))
    assert about(still, "instants").saves_s is None
    assert about(moving, "instants").saves_s == pytest.approx(
        9 * (160 - 20) * price_s("interpolated") * 40 * 26 / 100_000
    )


def test_a_skipped_view_saves_its_sweep():
    plan, _, _ = make_plan(ReconstructionConfig(), RIG, streams(dark=("cam20",)))
    assert about(plan, "views").saves_s > 0


def test_a_plan_without_prices_is_read():
    document = dataclasses.asdict(make_plan(ReconstructionConfig(), RIG, streams())[0])
    for decision in document["decisions"]:
        del decision["saves_s"], decision["saves_bytes"]
    assert all(d.saves_s is None and d.saves_bytes is None for d in Plan.from_json(document).decisions)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"model": "crystal"}, "found model 'crystal', expected one of auto, static, linear"),
        ({"budget_s": None}, "both or neither"),
        ({"steps": 5}, "both or neither"),
        ({"budget_s": 0.0}, "found the budget 0.0"),
        ({"budget_s": float("nan")}, "found the budget nan"),
        ({"budget_s": None, "steps": 0}, "found 0 steps"),
        ({"holdout": "cam11", "views": ("cam11",)}, "both held out and among"),
        ({"device": "tpu"}, "found device 'tpu', expected one of auto, cpu, cuda"),
        ({"device": "cuda", "model": "spikenerf"}, "found --device cuda with --model spikenerf, expected a model of"),
        ({"device": "cuda", "model": "dy-spikenerf"}, "--model dy-spikenerf.*; take --device cpu"),
    ],
)
def test_impossible_configurations_are_refused(options, message):
    with pytest.raises(BadRunError, match=message):
        ReconstructionConfig(**options)


def test_no_motion_saves_a_search_for_movers_however_long_the_training():
    found = [make_plan(ReconstructionConfig(budget_s=None, steps=n), RIG, streams())[0] for n in (500, 1000)]
    once, twice = (about(plan, "motion").saves_s for plan in found)
    assert once == twice > 0


def test_the_cap_of_gaussians_is_the_operators_or_follows_the_pixels():
    asked, _, _ = make_plan(ReconstructionConfig(gaussians=77), RIG, streams())
    assert asked.still_gaussians == 77
    plan, _, _ = make_plan(ReconstructionConfig(), RIG.scaled(400, 250), streams())
    assert plan.still_gaussians == METHODS["static"].gaussians


def test_spans_share_more_gaussians_of_what_stands_still_but_for_a_cap():
    def split(**choices):
        plan, _, _ = make_plan(ReconstructionConfig(**choices), RIG, streams(moving=True))
        return np.array([plan.still_gaussians, plan.moving_gaussians])

    usual = 2 * 40 * 26
    assert split(span=64).tolist() == (split(span=64, gaussians=usual) * [STILL_ONCE, 1]).tolist()
    assert split().tolist() == split(gaussians=usual).tolist()
    assert sum(split(span=64, gaussians=usual)) == usual


@pytest.mark.parametrize(
    ("size", "budget_s", "parts", "gaussians"),
    [
        ((400, 250), 600.0, 1, 48_000),
        ((640, 480), 600.0, 1, 48_000),
        ((1000, 1000), 60.0, 1, 48_000),
        ((1000, 1000), 180.0, 1, 96_000),
        ((1000, 1000), 600.0, 1, 192_000),
        ((1000, 1000), 6000.0, 1, 192_000),
        ((1000, 1000), 600.0, 4, 48_000),  # as much time as 150 s for each
        ((40, 26), 600.0, 1, 2 * 40 * 26),
        ((1, 1), 0.0, 1, 2),
    ],
)
def test_large_pictures_get_more_gaussians_where_time_pays_for_them(size, budget_s, parts, gaussians):
    work = Work(size[0] * size[1], 400, 8, 0, budget_s, None)
    assert work.with_gaussians(48_000, parts).gaussians == gaussians
    long = dataclasses.replace(work, budget_s=None, steps=10_000)
    assert long.with_gaussians(48_000, 1).gaussians == (192_000 if size == (1000, 1000) else gaussians)


@pytest.mark.parametrize(
    ("size", "doublings"), [((400, 250), ()), ((640, 480), ()), ((1000, 1000), (0.75,)), ((2000, 1000), (0.375, 0.75))]
)
def test_large_pictures_are_small_at_first(size, doublings):
    decisions = []
    work = Work(size[0] * size[1], 400, 8, 48_000, 60.0, None)
    assert _choose_sizes(work, METHODS["bases"], decisions) == doublings
    assert len(decisions) == bool(doublings)
    assert _choose_sizes(work, METHODS["spikenerf"], []) == ()
    if doublings:
        assert decisions[0].saves_s == pytest.approx(0.75 * work.halving_s(1.0))
        assert 0 < decisions[0].saves_s < 60


def test_the_lists_of_choices_are_those_of_the_contract():
    assert set(CHOICES["model"]) == {
        *("auto", "static", "linear", "cubic", "bases", "4dgs", "4dgs-small", "stg", "d3dgs"),
        *("spikegs", "dy-spikegs", "spikenerf", "dy-spikenerf"),
    }
    assert set(CHOICES["init"]) == {"auto", "sweep", "natural", "sfm", "dust3r", "msdi"}
    assert set(CHOICES["images"]) == {
        *("auto", "tfi", "tfp", "tfstp", "tvs", "slope", "adaptive", "interpolated"),
        *("spk2imgnet", "blindspot", "msdi", "clean", "blurred", "ordinary"),
    }
    assert set(CHOICES["supervision"]) == {
        *("auto", "pixels", "l1", "l2", "image-variation", "variation", "counts", "cumulative", "both")
    }


def test_variation_was_the_name_of_a_loss_on_images_in_earlier_revisions():
    named = ReconstructionConfig(supervision="variation")
    assert ReconstructionConfig.from_json(dataclasses.asdict(named)) == named
    plan, _, _ = make_plan(named, RIG, streams())
    assert plan.supervision == "variation"
    assert Plan.from_json(dataclasses.asdict(plan)) == plan
    before = {name: value for name, value in dataclasses.asdict(named).items() if name != "device"}
    assert ReconstructionConfig.from_json(before).supervision == "image-variation"
    old_plan = {name: value for name, value in dataclasses.asdict(plan).items() if name != "spans"}
    assert Plan.from_json(old_plan).supervision == "image-variation"


def test_listing_the_choices_loads_no_torch():
    listing = "import sys; from reconstruction.run.configuration import CHOICES; print('torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", listing], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize(
    ("choices", "points", "said"),
    [
        ({}, "swept", None),
        ({"init": "natural"}, "swept", None),
        ({"init": "msdi"}, "swept", "those of msdi are worse or fewer"),
        ({"init": "msdi", "model": "4dgs"}, "found", "they are part of the published method"),
        ({"init": "sfm", "model": "4dgs"}, "swept", "those of sfm are worse or fewer"),
        ({"init": "sfm", "points": "found"}, "found", None),
        ({"init": "msdi", "points": "swept"}, "swept", None),
        ({"points": "random"}, "random", None),
    ],
)
def test_points_are_swept_but_for_baselines_with_msdi_and_where_others_are_asked_for(choices, points, said):
    plan, *_ = make_plan(ReconstructionConfig(**choices), RIG, streams())
    assert plan.points == points
    assert [d.reason for d in plan.decisions if d.about == "points"] == ([said] if said else [])


@pytest.mark.parametrize("init", ["auto", "sweep", "natural"])
def test_points_of_an_initialiser_that_finds_none_are_refused(init):
    with pytest.raises(BadRunError, match=r"found --points found with the poses of .*, expected one that finds points"):
        make_plan(ReconstructionConfig(init=init, points="found"), RIG, streams())


def test_bodies_are_followed_through_fewer_sweeps_in_one_piece_alone():
    def sweeps(**choices):
        return make_plan(ReconstructionConfig(**choices), RIG, streams(moving=True))[0].sweeps

    assert (sweeps(), sweeps(span=64), sweeps(model="stg")) == (METHODS["bases"].sweeps, SWEEPS, SWEEPS)
    plan, *_ = make_plan(ReconstructionConfig(), RIG, streams(moving=True))
    older = {name: value for name, value in dataclasses.asdict(plan).items() if name != "sweeps"}
    assert Plan.from_json(older).sweeps == SWEEPS


@pytest.mark.parametrize("points", ["found", "random"])
def test_a_long_recording_is_in_one_piece_where_its_points_are_not_swept(points):
    long = {"span": 64, "init": "msdi"}
    assert make_plan(ReconstructionConfig(points=points, **long), RIG, streams(moving=True))[0].spans == ()
    plan, *_ = make_plan(ReconstructionConfig(**long), RIG, streams(moving=True))
    assert len(plan.spans) > 1
    assert plan.points == "swept"


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        ({"seed": -1}, "found the seed -1, expected one of 0 to 2147483647"),
        ({"seed": 2**31}, "found the seed 2147483648"),
        ({"budget_s": float("inf")}, "found the budget inf s"),
        ({"budget_s": float("nan")}, "found the budget nan s"),
        ({"views": ("cam00", "cam01", "cam00")}, "found the views cam00, cam01, cam00, expected each camera once"),
    ],
)
def test_choices_that_a_later_stage_would_fail_on_are_refused(choices, said):
    with pytest.raises(BadRunError, match=said):
        ReconstructionConfig(**choices)


def test_pictures_of_several_sizes_are_refused_by_name():
    cameras = tuple(c.scaled(20, 13) if c.id == "cam12" else c for c in RIG.cameras)
    rig = dataclasses.replace(RIG, cameras=cameras)
    with pytest.raises(BadRunError, match=r"several sizes: cam12 20x13, expected 40x26 px.*--views"):
        make_plan(ReconstructionConfig(), rig, streams())
    plan, _, _ = make_plan(ReconstructionConfig(holdout="cam12"), rig, streams())
    assert len(plan.views) == 8


@pytest.mark.parametrize(
    ("choices", "about", "choice"),
    [
        ({"images": "tfp", "window": 21}, "windows", "21 planes, not used"),
        ({"supervision": "l1", "span": 100}, "spans", "one, the whole"),
        ({"dust3r_checkpoint": "weights.pth"}, "checkpoint", "not read"),
    ],
)
def test_an_option_that_changes_nothing_is_said(choices, about, choice):
    plan, _, _ = make_plan(ReconstructionConfig(**choices), RIG, streams(moving=True))
    assert [d.choice for d in plan.decisions if d.about == about] == [choice]


def test_views_that_are_named_tell_how_long_a_part_is():
    asked, ids = [], ("cam00", "cam01", "cam11", "cam12")
    recording = SimpleNamespace(camera_ids=ids, part=lambda *part: asked.append(part))
    ReconstructionConfig(holdout="cam11").part_of(recording)
    ReconstructionConfig(holdout="cam11", views=("cam00", "cam01", "cam99"), to_tick=9).part_of(recording)
    assert asked == [(None, None, []), (None, 9, ["cam00", "cam01", "cam11"])]
