"""The bench of long recordings: what it makes of its rows, its page and picture, its parts, and that it resumes."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from acquisition.bench_document import SPAN
from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.bench.long import bench as long_bench
from reconstruction.bench.long import spans as long_spans
from reconstruction.bench.long.bench import ALONE, BASELINE, WHOLE, LongBench, LongClip, summarise
from reconstruction.bench.long.page import page, plot_long
from reconstruction.bench.long.part import cut_out
from reconstruction.bench.speed.run import NEW, Contender
from reconstruction.errors import ReconstructionError
from reconstruction.evaluation.evaluate import INSTANTS
from reconstruction.run.spans import Span
from reconstruction.truth import Truth, spread
from rigs.toml import catalog_rig

CONTENDER = Contender(NEW, ("spike4dgs",), Path("python"))
SPANS = [
    {"first_tick": 400 * i, "last_tick": 400 * i + 399, "psnr_db": 36.0 + i, "dynamic_psnr_db": 33.0, "seconds": 15.0}
    for i in range(3)
]


def end(psnr_db: float, **more: object) -> dict:
    row = {"seconds": 50.0, "wall_s": 60.0, "peak_mb": 500.0, "stored_bytes": 4_000_000, "steps": 900, "stolen": 0.0}
    row |= {"gaussians": 48_000}
    return row | {"psnr_db": psnr_db, "dynamic_psnr_db": 32.5, "abs_rel": 0.01, "revision": "abc"} | more


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A bench of one clip whose runs are not run, and the recordings that it asked to be reconstructed."""
    asked = []

    def run_to_end(contender, recording, out, budget_s, told, model="auto"):
        asked.append((recording.name, budget_s))
        if model != "auto":
            return end(25.0, spans=[])
        whole = recording.name == "rec"
        return end(37.0, wall_s=75.0, stored_bytes=6_000_000, spans=list(SPANS)) if whole else end(36.5)

    def cut_out(recording, span, out):
        out.mkdir(parents=True)

    monkeypatch.setattr(long_bench, "run_to_end", run_to_end)
    monkeypatch.setattr(long_bench, "cut_out", cut_out)
    monkeypatch.setattr(long_bench.Recording, "open", lambda path: None)
    clip = LongClip("carried_boxes", 1, 1200, lambda: tmp_path / "rec", 20.0, ("stg",))
    return LongBench([clip], CONTENDER, tmp_path / "work", silent), asked


def test_the_whole_and_every_so_many_parts_are_run_once(bench):
    measured, asked = bench
    document = measured.run()
    assert asked == [("rec", 60.0), ("carried_boxes-1200-2", 60.0), ("rec", 60.0)]
    assert [row["part"] for row in document.rows] == [WHOLE, SPAN, SPAN, SPAN, ALONE, BASELINE]
    measured.run()
    assert len(asked) == 3
    assert "spans" not in document.rows[0]
    assert {row["revision"] for row in document.rows} == {"abc"}


def test_the_whole_is_compared_with_its_parts(bench):
    summary = bench[0].run().summary
    clip = "carried_boxes-1200"
    assert summary[f"{clip}.psnr_db"] == pytest.approx(38.0 - 36.5)
    assert summary[f"{clip}.dynamic_psnr_db"] == pytest.approx(0.5)
    assert summary[f"{clip}.seconds_ratio"] == pytest.approx(75 / 1200 / (60 / 400))
    assert summary[f"{clip}.bytes_ratio"] == pytest.approx(6 / 1200 / (4 / 400))
    assert summary[f"{clip}.memory_ratio"] == pytest.approx(1.0)
    assert summary[f"{clip}.above_best.psnr_db"] == pytest.approx(37.0 - 25.0)


def test_a_part_is_compared_with_the_span_of_the_same_planes():
    """Rows of older revisions have spans at rest in one, so that their numbers are not those of parts."""
    spans = [SPANS[0] | {"last_tick": 799}, SPANS[2]]
    rows = [{"part": SPAN, "clip": "a", "number": i} | span for i, span in enumerate(spans)]
    whole = {"part": WHOLE, "clip": "a", "seam_ratio": 1.2} | end(37.0, planes=1200)
    parts = [
        {"part": ALONE, "clip": "a", "first_tick": first, "last_tick": first + 399, "planes": 400} | end(30.0)
        for first in (0, 800)
    ]
    summary = summarise([whole, *rows, *parts])
    assert summary["a.psnr_db"] == pytest.approx(38.0 - 30.0)
    assert summary["a.seam_ratio"] == 1.2


def test_a_clip_without_parts_or_spans_says_nothing():
    whole = {"part": WHOLE, "clip": "a"} | end(30.0, planes=1200)
    assert summarise([whole]) == {}
    assert (
        summarise([whole, {"part": ALONE, "clip": "a", "first_tick": 400, "last_tick": 799, "planes": 400} | end(30.0)])
        == {}
    )


def trained_in(spans: list[Span], planes: int = 1200) -> Any:
    """Return a run of so many planes in `spans`, whose truth has every 20th plane."""
    known = SimpleNamespace(planes=lambda camera_id: list(range(0, planes, 20)))
    held_out = SimpleNamespace(camera=SimpleNamespace(id="cam11"))
    run = SimpleNamespace(plan=SimpleNamespace(spans=spans))
    return SimpleNamespace(
        cloud=None, held_out=held_out, truth=known, run=run, recording=SimpleNamespace(planes=planes)
    )


@pytest.fixture
def seen(monkeypatch):
    """The planes that were scored, all of them 40 dB."""
    asked = []

    def score_at(cloud, held_out, truth, planes):
        asked.append(planes)
        return {"psnr_db": 40.0, "ssim": 0.9}

    monkeypatch.setattr(long_spans, "score_at", score_at)
    return asked


def test_a_span_is_scored_on_the_instants_of_the_part_alone(seen):
    """Ends are the worst, so that fewer instants give them more weight."""
    trained = trained_in([Span(400 * i, 400 * i + 400) for i in range(3)])
    found = long_spans.scored_spans(trained, SPANS)
    alone = spread(list(range(0, 400, 20)), INSTANTS)
    assert seen == [[plane + 400 * i for plane in alone] for i in range(3)]
    ends = {key: SPANS[1][key] for key in ("first_tick", "last_tick", "seconds")}
    assert found[1] == ends | {"span": 1, "psnr_db": 40.0, "instants": INSTANTS}
    trained.truth = None
    assert long_spans.scored_spans(trained, SPANS) == SPANS


def test_spans_that_were_joined_are_scored_one_by_one(seen):
    """So a part that was reconstructed alone has something to be compared with wherever it lies."""
    told = [SPANS[0], SPANS[1] | {"last_tick": 1199}]
    found = long_spans.scored_spans(trained_in([Span(0, 400), Span(400, 1200)]), told)
    assert [(row["first_tick"], row["last_tick"], row["seconds"]) for row in found] == [
        (0, 399, 15.0),
        (400, 799, 7.5),
        (800, 1199, 7.5),
    ]
    assert [row["span"] for row in found] == [0, 1, 1]
    assert [planes[0] // 400 for planes in seen] == [0, 1, 2]


def test_a_span_that_was_cut_otherwise_is_scored_as_it_is(seen):
    told = [{"first_tick": 0, "last_tick": 599, "seconds": 9.0}, {"first_tick": 600, "last_tick": 1199, "seconds": 9.0}]
    found = long_spans.scored_spans(trained_in([Span(0, 600), Span(600, 1200)]), told)
    assert [(row["first_tick"], row["last_tick"], row["seconds"]) for row in found] == [(0, 599, 9.0), (600, 1199, 9.0)]


def test_clips_of_an_earlier_document_stay_where_they_are_not_measured_again(bench):
    measured, _ = bench
    own, other = (
        {"part": WHOLE, "scene": "pushed_blocks"} | end(30.0, clip=name) for name in ("carried_boxes-1200", "b")
    )
    measured.earlier = [own, other]
    rows = measured.run().rows
    assert rows[-1] == other
    assert own not in rows
    assert {row["clip"] for row in rows} == {"carried_boxes-1200", "b"}
    measured.work, measured.time_left = measured.work / "empty", lambda: False
    late = measured.run()
    assert (late.rows, len(late.omissions)) == ([own, other], 1)


def test_what_fails_or_has_no_time_is_an_omission(bench, monkeypatch):
    def fails(*_: object, **__: object) -> dict:
        raise ReconstructionError("found exit code 1")

    measured, _ = bench
    monkeypatch.setattr(long_bench, "run_to_end", fails)
    assert any("found exit code 1" in line for line in measured.run().omissions)
    measured.time_left = lambda: False
    assert any("no time was left" in line for line in measured.run().omissions)


def test_without_time_what_was_measured_before_is_told(bench):
    measured, asked = bench
    found = measured.run()
    measured.time_left = lambda: False
    again = measured.run()
    assert (again.rows, again.omissions, len(asked)) == (found.rows, found.omissions, 3)


def test_page_and_picture_have_every_run(bench, tmp_path):
    document = bench[0].run().to_json()
    text = page(document)
    said = ["## carried_boxes-1200", "| in spans | 1,200 |", "| part 2 alone | 400 |", "| `stg` in one piece | 1,200 |"]
    said += ["| Gaussians |", "| 48,000 |", "fewer Gaussians", "on 4 instants", "were joined"]
    for words in (*said, "| seconds a plane, over"):
        assert words in text
    assert "A development scene. Revision abc, " in text
    alike = [row | {"instants": 8} for row in document["rows"]]
    assert "as many instants as the part alone" in page(document | {"rows": alike})
    unseen = [row | {"scene": "pushed_blocks"} for row in document["rows"]]
    assert "An evaluation scene. Revision abc, " in page(document | {"rows": unseen})
    plot_long(tmp_path / "long.png", document)
    assert (tmp_path / "long.png").read_bytes().startswith(b"\x89PNG")
    plot_long(tmp_path / "none.png", document | {"rows": []})
    assert not (tmp_path / "none.png").exists()


@pytest.mark.slow
def test_a_part_has_the_planes_and_the_truth_of_the_whole(tmp_path):
    simulate(Simulation("fan_and_ball", seed=1), catalog_rig("ci3x3"), 120, tmp_path / "rec")
    whole = Recording.open(tmp_path / "rec")
    cut_out(whole, Span(30, 90), tmp_path / "part")
    part = Recording.open(tmp_path / "part")
    assert part.planes == 60
    for camera_id in whole.camera_ids:
        assert np.array_equal(part.stream(camera_id).planes(0, 60), whole.stream(camera_id).planes(30, 90))
    assert whole.truth is not None
    assert part.truth is not None
    known, own = Truth.open(whole.truth), Truth.open(part.truth)
    assert own.planes("cam11") == [plane - 30 for plane in known.planes("cam11") if 30 <= plane < 90]
    for plane in own.planes("cam11"):
        assert np.array_equal(own.frame("cam11", plane).depth, known.frame("cam11", plane + 30).depth, equal_nan=True)
