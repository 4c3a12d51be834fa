"""The bench of rivals: every row at every length on every scene, tables printed when they are complete."""

import itertools
import json
from dataclasses import asdict

import pytest

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, REALISTIC, REALISTIC_EVALUATION
from reconstruction.bench.conventions import seed_of
from reconstruction.bench.paper.method import Effort
from reconstruction.bench.paper.tables import sittings
from reconstruction.bench.rivals import diagram
from reconstruction.bench.rivals.bench import GROUPS, METHODS, ROWS, bench_rivals, rivals_protocol, write_page
from reconstruction.bench.rivals.diagram import plot_rivals

ABOUT = {"revision": "abc", "device": {"processor": "p", "threads": 2}}


def measured(laboratory, known_of=lambda cell: True):
    def scores_of(cell):
        level = 40.0 - METHODS.index(cell.method.name) - (1 if cell.scene == EVALUATION[0] else 0)
        row = {"psnr_db": level, "ssim": 0.9, "abs_rel": 0.01, "delta_1_25": 1.0, "steps_per_s": 20.0, "gaussians": 9}
        row |= {"curve": [], "processor": "p", "threads": 2, "seconds": cell.effort.budget_s}
        return row if known_of(cell) else None

    protocol = rivals_protocol()
    document = bench_rivals(protocol, laboratory(scores_of), lambda done, message: None, lambda: False)
    return protocol, asdict(document) | ABOUT


def test_all_rows_are_run_in_turns_at_every_length_a_scene_at_a_time():
    assert len(ROWS) == len(METHODS) <= 8
    cells = rivals_protocol().cells()
    lengths = {effort for group in GROUPS.values() for effort in group.lengths}
    assert lengths == {Effort(15.0), Effort(60.0), Effort(300.0), Effort(1800.0)}
    for cell in cells:
        assert cell.method.config(cell.effort, cell.seed).budget_s == cell.effort.budget_s
    planned = set()
    for group in GROUPS.values():
        rows = [row.method.name for row in group.rows]
        for scene in group.scenes:
            wanted = set(itertools.product([scene], group.lengths, rows, group.seeds)) - planned  # shared ones: once
            planned |= wanted
            own, cells = cells[: len(wanted)], cells[len(wanted) :]
            seen = {(cell.scene, cell.effort, cell.method.name) for cell in own}
            assert seen == {run[:-1] for run in wanted}
    assert cells == []
    assert [row.label.split(",")[0] for row in GROUPS["half-hour"].rows] == [
        "TFI + 4DGS",
        "the paper's chain as we read it",
    ]


def test_distances_are_over_the_scenes_of_a_table_and_name_the_worst(tmp_path, told_laboratory):
    protocol, document = measured(told_laboratory)
    name = METHODS[2]
    assert document["summary"][f"old.{name}.above_ours.psnr_db.mean@60"] == pytest.approx(-2.0)
    assert document["summary"][f"old.{name}.above_ours.psnr_db.most@60"] == pytest.approx(-2.0)
    assert not [key for key in document["summary"] if ".above_ours.dynamic_psnr_db" in key]
    write_page(tmp_path / "rivals.md", document, protocol)
    text = (tmp_path / "rivals.md").read_text()
    assert "| Our images + STG | 60 s | 38.00 | -2.00 |" in text
    assert "still lack runs" not in text
    plot_rivals(tmp_path / "rivals.png", json.loads(json.dumps(document)))
    assert (tmp_path / "rivals.png").stat().st_size > 0
    plot_rivals(tmp_path / "none.png", {"rows": [], "omissions": []})
    assert not (tmp_path / "none.png").exists()


def test_a_scene_of_a_table_that_lacks_runs_and_more_seeds_are_not_drawn(tmp_path, told_laboratory, monkeypatch):
    drawn = []
    recordings = lambda document, rows, *about: drawn.append({(row["scene"], row["seed"]) for row in rows})  # noqa: E731
    monkeypatch.setattr(diagram, "caption", recordings)
    lacking = REALISTIC_EVALUATION[1], METHODS[-1]
    for known_of in (lambda cell: True, lambda cell: (cell.scene, cell.method.name) != lacking):
        _, document = measured(told_laboratory, lambda cell, of=known_of: of(cell) and cell.effort.budget_s <= 60)
        plot_rivals(tmp_path / "rivals.png", json.loads(json.dumps(document)))
    known = *DEVELOPMENT, *REALISTIC, *EVALUATION
    assert drawn == [{(s, seed_of(s)) for s in (*known, *more)} for more in (REALISTIC_EVALUATION, ())]


@pytest.mark.parametrize(
    ("lacking", "panels"), [(None, ["15, 60 s: 14", "15, 60, 300 s: 2"]), (300.0, ["15, 60 s: 14"])]
)
def test_a_panel_has_the_recordings_of_its_lengths(tmp_path, told_laboratory, monkeypatch, lacking, panels):
    figures = []
    monkeypatch.setattr(diagram, "write_figure", lambda path, figure, below: figures.append(figure))
    _, document = measured(told_laboratory, lambda cell: cell.effort.budget_s != lacking)
    plot_rivals(tmp_path / "rivals.png", document)
    (figure,) = figures
    assert [axes.get_title() for axes in figure.axes] == [f"recordings run for {panel}" for panel in panels]
    for axes, panel in zip(figure.axes, panels, strict=True):
        ends = [line for line in axes.lines if not line.get_label().startswith("_")]
        assert [line.get_label() for line in ends] == [row.label for row in ROWS]
        assert {len(line.get_xdata()) for line in ends} == {panel.count(",") + 1}


def test_a_table_that_lacks_a_run_is_not_printed(tmp_path, told_laboratory):
    lacking = ("new", REALISTIC_EVALUATION[1], METHODS[-1])
    protocol, document = measured(told_laboratory, lambda cell: (cell.scene, cell.method.name) != lacking[1:])
    write_page(tmp_path / "rivals.md", document, protocol)
    text = (tmp_path / "rivals.md").read_text()
    assert "not printed: new, new-long." in text
    assert "not run yet" not in text
    assert "(`old`)" in text
    assert "(`new`)" not in text


def test_the_page_says_what_was_run_when_and_on_what():
    own = {"processor": "p", "threads": 2, "revision": "a"}
    rows = [own | {"day": "2026-01-02", "seconds": 1800.0}, own | {"day": "2026-01-02", "seconds": 3600.0}, own, {}]
    lines = sittings(rows).splitlines()[4:]
    assert lines == ["| 2026-01-02 | a | p, 2 threads | 2 | 1.5 |", "| not kept | a | p, 2 threads | 1 | 0.0 |"]
