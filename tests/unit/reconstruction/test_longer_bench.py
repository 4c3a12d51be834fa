"""The bench of longer training: each arm takes one cause away, and each longer run is held against its shorter one."""

from dataclasses import asdict, replace
from types import SimpleNamespace

import pytest

from acquisition.devices.open import Simulation
from acquisition.recording.reader import Recording
from acquisition.scenes.truth import EVERY
from acquisition.session.record import simulate
from reconstruction.bench.conventions import HOLDOUT, VIEWS, truth_of
from reconstruction.bench.longer import ARMS, EFFORTS, JUDGE, SCENES, SPARSE, bench_longer, longer_protocol, write_page
from reconstruction.images.composite import CompositeSource
from rigs.toml import catalog_rig

KINDS = ("real", "ideal")
ABOUT = {"revision": "abc", "device": {"processor": "p", "threads": 2}}


def found_by(laboratory, level, scenes=SCENES[:2]):
    def scores_of(cell):
        db = level(cell)
        return None if db is None else {"psnr_db": db, "abs_rel": 0.01}

    laboratories = dict.fromkeys(KINDS, laboratory(scores_of))
    return bench_longer(laboratories, scenes, lambda done, message: None, lambda: False)


def test_every_arm_is_run_once_at_both_lengths():
    cells = [cell for kind in KINDS for cell in longer_protocol(SCENES, kind).cells()]
    assert len({cell.name for cell in cells}) == len(cells) == len(SCENES) * len(ARMS) * len(EFFORTS)


def test_the_camera_that_judges_is_held_out_and_so_is_the_usual_one():
    for _, method in ARMS.values():
        config = method.config(EFFORTS[0], 1)
        judged = method.name == "judged"
        assert config.holdout == (JUDGE if judged else HOLDOUT)
        assert not {HOLDOUT, config.holdout} & set(config.views or VIEWS)


def test_a_longer_run_is_held_against_the_shorter_one_of_its_scene_and_arm(tmp_path, told_laboratory):
    def level(cell):
        if (cell.scene, cell.method.name, cell.effort.label) == (SCENES[1], "clean", EFFORTS[1].label):
            return None
        return 30.0 + (0.5 if cell.effort == EFFORTS[1] else 0.0)

    document = found_by(told_laboratory, level)
    assert document.summary[f"{SCENES[0]}.auto.longer.psnr_db"] == pytest.approx(0.5)
    assert f"{SCENES[0]}.auto.longer.dynamic_psnr_db" not in document.summary  # a scene without movers
    assert f"{SCENES[1]}.clean.longer.psnr_db" not in document.summary
    write_page(tmp_path / "longer.md", asdict(document) | ABOUT)
    text = (tmp_path / "longer.md").read_text()
    assert f"| {SCENES[0]} | as it is | 30.00 |  | 0.0100 | 30.50 |  | 0.0100 | +0.50 |  | +0.0000 |" in text
    assert f"| {SCENES[1]} | clean images |" not in text
    assert "No row has yet" not in text
    rows = [row for row in document.rows if row["method"] != "every-20"]
    write_page(tmp_path / "older.md", asdict(document) | ABOUT | {"rows": rows})
    assert f"No row has yet: {SPARSE}." in (tmp_path / "older.md").read_text()


def test_spike_images_of_one_arm_are_as_many_as_clean_ones(tmp_path):
    rig = catalog_rig("ci3x3").scaled(16, 10).only(["cam00"])
    simulate(Simulation("fan_and_ball", seed=1), rig, 60, tmp_path / "rec")
    recording, arm = Recording.open(tmp_path / "rec"), ARMS[SPARSE][1].config(EFFORTS[0], 1)
    spikes = CompositeSource.instants(SimpleNamespace(stream=range(recording.planes)), arm.tick_stride)  # pyright: ignore[reportArgumentType]
    clean = truth_of(recording).planes("cam00")
    assert len(spikes) == len(clean) == 3
    assert [b - a for a, b in zip(clean, spikes, strict=True)] == [EVERY // 2] * 3
    plain = ARMS["clean images"][1].config(EFFORTS[0], 1)
    assert replace(arm, images=plain.images, tick_stride=plain.tick_stride) == plain
