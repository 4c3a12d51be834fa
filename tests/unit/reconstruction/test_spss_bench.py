"""The bench of SPSS: every base without it and by weight, and gains over the scenes that both have."""

from dataclasses import asdict

import pytest

from reconstruction.bench.paper.bench import NOT_RUN
from reconstruction.bench.paper.method import Effort
from reconstruction.bench.spss import BASES, EFFORTS, SCENES, WEIGHTS, bench_spss, spss_protocol, weighted, write_page
from rigs.toml import catalog_rig

RIG = catalog_rig("ci3x3").scaled(40, 25)


def found_by(laboratory, level):
    def scores_of(cell):
        db = level(cell)
        known = {"psnr_db": db, "dynamic_psnr_db": db, "abs_rel": 0.01, "steps_per_s": 20.0}
        return None if db is None else known

    return bench_spss(spss_protocol(), laboratory(scores_of), RIG, lambda done, message: None, lambda: False)


def test_every_base_has_every_weight_at_equal_steps_and_equal_time():
    cells = spss_protocol().cells()
    kept = [cell for cell in cells if not cell.method.name.endswith("+spss-alone")]
    assert len(kept) == len(SCENES) * len(EFFORTS) * len(BASES) * (1 + len(WEIGHTS))
    assert {effort.budget_s is None for effort in EFFORTS} == {True, False}
    config = weighted(BASES[0], 0.1).config(Effort(60.0), 1)
    assert (config.supervision, config.spike_weight) == ("variation", 0.1)
    assert BASES[0].config(Effort(60.0), 1).spike_weight is None


def test_the_loss_alone_has_no_weight_and_equal_steps():
    cells = [cell for cell in spss_protocol().cells() if cell.method.name.endswith("+spss-alone")]
    assert len(cells) == len(SCENES) * len(BASES)
    configs = [cell.method.config(cell.effort, cell.seed) for cell in cells]
    assert {(one.supervision, one.spike_weight, one.steps) for one in configs} == {("variation", None, 1000)}


def test_gains_are_over_the_scenes_that_both_rows_have(tmp_path, told_laboratory):
    missing = (SCENES[-1], "auto+spss@0.1")
    level = lambda cell: None if (cell.scene, cell.method.name) == missing else _level(cell)  # noqa: E731
    document = found_by(told_laboratory, level)
    assert document.summary["auto+spss@0.1.gain.psnr_db@60"] == pytest.approx(0.5)
    assert document.summary["auto+spss@0.1.scenes@60"] == len(SCENES) - 1
    assert "auto.gain.psnr_db@60" not in document.summary
    assert document.summary["auto+spss-alone.gain.psnr_db@1000steps"] == pytest.approx(1 / 3)
    assert "auto+spss-alone.psnr_db@60" not in document.summary
    about = {"revision": "abc", "device": {"processor": "p", "threads": 2}}
    document.omissions = [line.replace(NOT_RUN, "refused") for line in document.omissions]
    write_page(tmp_path / "spss.md", asdict(document) | about)
    text = (tmp_path / "spss.md").read_text()
    assert "| auto+spss@0.1 | 60 | 30.00 | 30.00 | +0.50 | +0.50 | 0.0100 | 20 | 2 |" in text
    assert "| auto | 1000steps | 30.00 | 30.00 |  |  | 0.0100 | 20 | 3 |" in text


def test_a_table_that_lacks_runs_is_not_printed(tmp_path, told_laboratory):
    document = asdict(found_by(told_laboratory, _level))
    document["omissions"].append(f"spss, auto: {NOT_RUN} (fan_and_ball-1 @60)")
    write_page(tmp_path / "spss.md", document | {"revision": "abc", "device": {"processor": "p", "threads": 2}})
    text = (tmp_path / "spss.md").read_text()
    assert "still lacks runs" in text
    assert "| auto" not in text


def _level(cell):
    return 29.0 + SCENES.index(cell.scene) + (1 if cell.scene == SCENES[0] else 0) * ("spss" in cell.method.name)
