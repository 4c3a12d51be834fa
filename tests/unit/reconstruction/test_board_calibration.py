"""Cameras from sightings of a board: exact where corners are exact, honest where they are not, refused by name."""

import dataclasses

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.recording.reader import Recording
from acquisition.scenes.catalog import build_scene
from acquisition.scenes.misplaced import misplaced
from acquisition.session.record import simulate
from reconstruction.calibration.board_corners import Sighting
from reconstruction.calibration.board_sightings import gathered
from reconstruction.calibration.board_spec import parse_board
from reconstruction.calibration.boards import calibrate_board, from_sightings
from reconstruction.calibration.projection import Cameras, project
from reconstruction.calibration.residual_picture import draw_residuals
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.metrics.poses import pose_errors
from rigs.exchange.cameras import load_cameras
from rigs.similarity import align
from rigs.toml import catalog_rig

BOARD = parse_board("charuco:6x4:100:67.5:DICT_4X4_50")
MIDDLE = np.array([0.3, 0.2, 0.0])
RIG = catalog_rig("lab3x3")
NOMINAL = misplaced(RIG, 2.0, 1)
INSTANTS_S = np.linspace(0, 0.3, 12)
DISTANCE_M = 1.45
DATE = "2026-11-21"


def seen_by(rig, noise_px=0.0, instants_s=INSTANTS_S, scale=1.0, bend_m=0.0):
    """Return what the cameras of `rig` see of a waved board printed at `scale`, its middle `bend_m` before its ends."""
    placed, rng = build_scene("board_charuco_moving", 0).placements(instants_s), np.random.default_rng(0)
    printed = scale * (BOARD.points - MIDDLE)
    printed[:, 2] += bend_m * np.cos(printed[:, 0] * 6)
    found = {}
    for number in range(len(instants_s)):
        points = printed @ placed.rotations[number, 1].T + placed.positions[number, 1]
        for index, camera in enumerate(rig.cameras):
            pixels = project(points, Cameras.of(rig.cameras), np.full(len(points), index)).pixels
            inside = ((pixels > 5) & (pixels < [camera.width - 5, camera.height - 5])).all(axis=1)
            pixels = pixels[inside] + rng.normal(0, noise_px, (int(inside.sum()), 2))
            found[number, camera.id] = Sighting(np.flatnonzero(inside), pixels)
    return gathered(rig.ids, found, len(instants_s))


def lens(rig, **change):
    """`rig` with lenses changed by functions of the camera's number."""
    values = [{name: of(number) for name, of in change.items()} for number in range(len(rig.cameras))]
    return dataclasses.replace(
        rig, cameras=tuple(dataclasses.replace(c, **v) for c, v in zip(rig.cameras, values, strict=True))
    )


def test_exact_corners_give_the_exact_cameras():
    found = from_sightings(NOMINAL, BOARD, seen_by(RIG), DATE)
    errors = pose_errors(found.rig, RIG, DISTANCE_M)
    assert np.abs(errors.turns_rad).max() < 1e-6
    assert np.abs(errors.shifts_m).max() < 1e-6
    assert errors.focal_percent < 1e-4
    assert align(found.rig, RIG).scale == pytest.approx(1.0, abs=1e-6)
    assert found.report["residual_px"] < 1e-4
    assert found.rig.poses == "calibrated"
    assert found.rig.calibration.date == DATE


def test_errors_are_what_the_standard_deviations_say():
    found = from_sightings(NOMINAL, BOARD, seen_by(RIG, noise_px=0.02), DATE)
    errors = pose_errors(found.rig, RIG, DISTANCE_M)
    assert errors.rotation_deg < 0.01
    assert errors.translation_percent < 0.02
    assert errors.focal_percent < 0.1
    turns = np.degrees(np.linalg.norm(errors.turns_rad, axis=1))
    ratio = np.sqrt(np.mean((turns / [found.sd[c].rotation_deg for c in RIG.ids]) ** 2))
    assert 0.4 < ratio < 2
    assert found.report["corner_sd_px"] == pytest.approx(0.02, rel=0.1)
    assert found.report["principal_point"].startswith("nominal")
    assert found.report["distortion"].startswith("nominal")


@pytest.mark.parametrize(
    ("change", "what", "tolerance"),
    [
        ({"cx": lambda n: 196.0 + n, "cy": lambda n: 128.0 - n / 2}, "principal_point", {"cx": 0.3, "cy": 0.3}),
        ({"distortion": lambda n: (-0.1 - 0.005 * n, 0.02, 0.0, 0.0)}, "distortion", {"cx": 0.5}),
        ({"fx": lambda n: 345.0 + 2 * n, "fy": lambda n: 345.0 + 2 * n}, "focal", {"fx": 0.3, "fy": 0.3}),
    ],
)
def test_lenses_that_differ_from_the_nominal_ones_are_found(change, what, tolerance):
    true = lens(RIG, **change)
    found = from_sightings(NOMINAL, BOARD, seen_by(true, noise_px=0.01), DATE)
    assert "found for each camera" in found.report[what]
    for camera in true.cameras:
        for name, most in tolerance.items():
            assert getattr(found.rig.camera(camera.id), name) == pytest.approx(getattr(camera, name), abs=most)
        if what == "distortion":
            assert found.rig.camera(camera.id).distortion[0] == pytest.approx(camera.distortion[0], abs=0.03)


@pytest.mark.parametrize(
    ("bends", "said", "at", "tolerance"),
    [
        ((-0.1, 0.0, 0.006, -0.004), "k1, p1 p2 found for each camera", (2, 3), 0.002),
        ((-0.1, 0.2, 0.0, 0.0, 1.5), "k1, k2, k3 found for each camera", (4,), 0.4),
    ],
)
def test_rare_parts_of_lenses_are_found_where_the_board_shows_them(bends, said, at, tolerance):
    true = lens(RIG, distortion=lambda _: bends)
    found = from_sightings(NOMINAL, BOARD, seen_by(true, noise_px=0.01), DATE)
    assert found.report["distortion"] == said
    assert found.report["residual_px"] < 0.02
    for number in at:
        values = [(*camera.distortion, 0.0)[number] for camera in found.rig.cameras]
        assert np.mean(values) == pytest.approx(bends[number], abs=tolerance)


def test_the_metres_are_the_boards_own():
    small = dataclasses.replace(BOARD, points=BOARD.points * 1.05)
    found = from_sightings(NOMINAL, small, seen_by(RIG), DATE)
    assert align(found.rig, RIG).scale == pytest.approx(1 / 1.05, rel=1e-5)


def test_a_board_that_stands_still_is_one_pose():
    sightings = seen_by(RIG, noise_px=0.01, instants_s=np.zeros(16))
    assert (sightings.poses, sightings.instants) == (1, 16)
    found = from_sightings(NOMINAL, BOARD, sightings, DATE)
    moving = from_sightings(NOMINAL, BOARD, seen_by(RIG, noise_px=0.01), DATE)
    assert found.sd["cam11"].focal_percent > 2 * moving.sd["cam11"].focal_percent


def test_what_one_pose_does_not_determine_is_refused_by_name():
    with pytest.raises(GeometryError, match=r"found 1 poses of the board, which leave cam00 .* too uncertain"):
        from_sightings(NOMINAL, BOARD, seen_by(RIG, noise_px=0.15, instants_s=np.zeros(1)), DATE)


def test_other_boards_and_rigs_are_refused():
    with pytest.raises(BadRunError, match=r"the board is printed at 0\.8\d times its SPEC"):
        from_sightings(NOMINAL, BOARD, seen_by(RIG, scale=0.8), DATE)
    with pytest.raises(BadRunError, match="the board is bent, or its millimetres are others"):
        from_sightings(NOMINAL, BOARD, seen_by(RIG, bend_m=0.02), DATE)
    swapped = dataclasses.replace(RIG, cameras=(RIG.cameras[2], *RIG.cameras[1:2], RIG.cameras[0], *RIG.cameras[3:]))
    named = [dataclasses.replace(c, id=i) for c, i in zip(swapped.cameras, RIG.ids, strict=True)]
    sightings = seen_by(dataclasses.replace(RIG, cameras=tuple(named)))
    with pytest.raises(GeometryError, match=r"found cam0[0-2] .* off the rig file"):
        from_sightings(NOMINAL, BOARD, sightings, DATE)


def test_the_picture_of_residuals_is_a_picture(tmp_path):
    import cv2

    draw_residuals(tmp_path / "a.png", from_sightings(NOMINAL, BOARD, seen_by(RIG, noise_px=0.02), DATE))
    image = cv2.imread(str(tmp_path / "a.png"))
    assert image.shape[0] > 600
    assert (np.ptp(image, axis=2) > 60).sum() > 1000  # coloured arrows on white


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Two windows of a recording of the still ChArUco board, by a rig off its drawing."""
    folder = tmp_path_factory.mktemp("boards") / "still"
    simulate(Simulation("board_charuco", samples=1, truth_every=1000, rig_error=2.0), RIG, 36, folder)
    return Recording.open(folder)


def test_a_recording_of_another_board_is_refused(still):
    def refusal(spec, error):
        with pytest.raises(error) as caught:
            calibrate_board(still, parse_board(spec), DATE)
        return str(caught.value)

    assert "found tags of DICT_4X4_50, expected DICT_5X5_50" in refusal("charuco:6x4:100:67.5:DICT_5X5_50", BadRunError)
    assert "another board: check columns" in refusal("charuco:4x6:100:67.5:DICT_4X4_50", BadRunError)


def test_cameras_that_do_not_see_the_board_are_named(still, tmp_path):
    dark = tmp_path / "dark"
    dark.mkdir()
    for file in still.path.iterdir():
        if file.is_file():
            data = file.read_bytes()
            covered = file.suffix == ".dat" and any(c in file.name for c in ("cam01", "cam20"))
            (dark / file.name).write_bytes(bytes(len(data)) if covered else data)
    with pytest.raises(GeometryError, match=r"found no board charuco\S+ in cam01, cam20, expected it in every camera"):
        calibrate_board(Recording.open(dark), BOARD, DATE)


def test_a_rig_of_other_cameras_is_refused(still):
    other = dataclasses.replace(still, rig=still.rig.scaled(200, 125))
    with pytest.raises(BadRunError, match="cam00: found planes of 400x250, expected 200x125"):
        calibrate_board(other, BOARD, DATE)


@pytest.mark.slow
@pytest.mark.long
def test_a_recording_of_a_waved_board_gives_the_cameras(tmp_path):
    spec = "charuco:6x4:100:67.5:DICT_4X4_50"
    simulate(
        Simulation("board_charuco_moving", samples=1, truth_every=2000, rig_error=2.0, seed=1),
        RIG,
        2000,
        tmp_path / "rec",
    )
    recording = Recording.open(tmp_path / "rec")
    true = load_cameras(tmp_path / "rec/truth/cameras.json", 20000.0).only(RIG.ids)
    found = calibrate_board(recording, parse_board(spec), DATE)
    errors = pose_errors(found.rig, true, DISTANCE_M)
    assert pose_errors(recording.rig, true, DISTANCE_M).rotation_deg > 1
    assert errors.rotation_deg < 0.02
    assert errors.translation_percent < 0.05
    assert errors.focal_percent < 0.1
    assert align(found.rig, true).scale == pytest.approx(1, abs=1e-3)
