"""The speed bench: what it makes of its rows, its page and its picture, its turns, and that it resumes."""

from pathlib import Path

import pytest

from acquisition.errors import AcquisitionError
from acquisition.progress import silent
from reconstruction.bench.diagrams import PLOTS
from reconstruction.bench.speed import bench
from reconstruction.bench.speed.bench import FULL, LARGE, LARGE_SIZE, QUICK, Clip, Extent, SpeedBench
from reconstruction.bench.speed.page import page, write_page
from reconstruction.bench.speed.run import NEW, OLD, Contender, StepSize
from reconstruction.bench.speed.summary import level_seconds, levels_db, serial_share, summarise
from reconstruction.errors import ReconstructionError

STAGES = {"plan": 1.0, "poses": 0.01, "images": 2.0, "points": 8.0, "train": 40.0, "report": 20.0}
SMALL = StepSize(2000, 200, 125, 3)
SHORT = Extent(((OLD, 6.0), (NEW, 2.0), (NEW, 6.0)), (SMALL,), SMALL, turns=2)


def end(clip: str, which: str, budget_s: float, psnr_db: float, movers_db: float, **more: float) -> dict:
    stages = {stage: seconds / (2 if which == NEW else 1) for stage, seconds in STAGES.items()}
    row = {"part": "ends", "clip": clip, "scene": clip, "seed": 1, "which": which, "command": which}
    row |= {"revision": which.upper(), "budget_s": budget_s, "seconds": budget_s + 0.5, "steps": 100, "stolen": 0.0}
    row |= {"gaussians": 48000, "peak_mb": 500.0, "psnr_db": psnr_db, "dynamic_psnr_db": movers_db, "abs_rel": 0.01}
    return row | {f"seconds.{stage}": seconds for stage, seconds in stages.items()} | more


def step(which: str, threads: int, seconds: float, median_s: float, **more: object) -> dict:
    row = {
        "part": "steps",
        "which": which,
        "command": which,
        "revision": which.upper(),
        "size": SMALL.label,
        "stolen": 0.0,
    }
    row |= {"threads": threads, "seconds": seconds, "median_s": median_s, "loaded": False, "steps": 6}
    return row | more


ROWS = [
    end("a", OLD, 20, 28.4, 24.0),
    end("a", OLD, 60, 31.2, 27.0, steps=200),
    end("a", NEW, 20, 31.7, 26.5, abs_rel=0.012),
    end("a", NEW, 60, 33.0, 29.0, steps=500),
    end("b", OLD, 60, 36.0, 30.0),
    end("b", NEW, 20, 35.5, 30.5),
    step(OLD, 1, 0.040, 0.050),
    step(NEW, 1, 0.020, 0.030),
    step(OLD, 2, 0.030, 0.036, **{"part_s.renderer": 0.010, "part_s.Adam": 0.003}),
    step(NEW, 2, 0.012, 0.018, **{"part_s.renderer": 0.004}),
    *(
        step(which, 2, seconds, median_s, part="loaded", loaded=load)
        for which, load, seconds, median_s in (
            (OLD, False, 0.03, 0.04),
            (OLD, True, 0.03, 0.08),
            (NEW, False, 0.01, 0.02),
            (NEW, True, 0.01, 0.03),
        )
    ),
]
DOCUMENT = {
    "bench": "speed",
    "device": {"processor": "a processor", "threads": 2},
    "revision": "NEW",
    "rows": ROWS,
    "omissions": ["one seed"],
    "summary": summarise(ROWS),
}


def test_gains_are_of_every_new_end_over_the_longest_old_one_that_of_its_budget_and_the_best():
    found = summarise(ROWS)
    assert found["a.old@60.psnr_db"] == 31.2
    assert found["a.new@20.dynamic_psnr_db"] == 26.5
    assert found["a.new@20-old@60.psnr_db"] == pytest.approx(0.5)
    assert found["a.new@20-old@60.dynamic_psnr_db"] == pytest.approx(-0.5)
    assert found["a.new@20-old@60.abs_rel"] == pytest.approx(0.002)
    assert found["a.new@60-old@60.psnr_db"] == pytest.approx(1.8)
    assert found["least.new@20-old@60.psnr_db"] == pytest.approx(-0.5)  # of b
    assert found["least.new@20-old@60.dynamic_psnr_db"] == pytest.approx(-0.5)  # of a
    assert not any(key.startswith("b.new@60") for key in found)
    assert found["a.new@20-old@20.psnr_db"] == pytest.approx(3.3)
    longer = [
        row | ({"psnr_db": 28.0} if row.get("which") == OLD and row.get("budget_s") == 60 else {}) for row in ROWS
    ]
    worse = summarise(longer)  # a longer old run that ends worse
    assert worse["a.new@20-old@best.psnr_db"] == pytest.approx(3.3)
    assert worse["a.new@20-old@best.dynamic_psnr_db"] == pytest.approx(-0.5)  # movers are best after 60
    assert worse["a.new@20-old@best.abs_rel"] == pytest.approx(0.002)


def test_a_level_is_reached_at_the_least_budget_whose_end_has_it():
    own = [row for row in ROWS if row.get("clip") == "a"]
    assert list(levels_db(own, "psnr_db")) == [28, 29, 30, 31, 32, 33]
    assert level_seconds([row for row in own if row["which"] == OLD], "psnr_db", 29) == 60
    assert level_seconds([row for row in own if row["which"] == OLD], "psnr_db", 32) is None
    found = summarise(ROWS)
    assert (found["a.old.seconds_to_28"], found["a.old.seconds_to_31"], found["a.new.seconds_to_31"]) == (20, 60, 20)
    assert found["a.new.movers_seconds_to_27"] == 60
    assert "a.old.seconds_to_32" not in found
    assert list(levels_db([], "psnr_db")) == list(levels_db([{"psnr_db": float("inf")}], "psnr_db")) == []


def test_stages_are_compared_at_the_longest_budget_that_both_have():
    found = summarise(ROWS)
    assert found["a.steps_x_old"] == 2.5
    assert found["a.points_x_old"] == found["a.report_x_old"] == 2.0
    assert "a.poses_x_old" not in found  # too short to compare
    assert "a.train_x_old" not in found
    assert not any(key.startswith("b.points") for key in found)


def test_steps_have_ratios_of_least_and_median_and_a_serial_share():
    found = summarise(ROWS)
    start = f"steps.{SMALL.label}"
    assert found[f"{start}.threads1.x_old"] == pytest.approx(2.0)
    assert found[f"{start}.threads2.x_old"] == pytest.approx(2.5)
    assert found[f"{start}.threads2.median_x_old"] == pytest.approx(2.0)
    assert found[f"{start}.threads1.new_ms"] == pytest.approx(20.0)
    assert found[f"{start}.old_serial_share"] == pytest.approx(0.5)
    assert found[f"{start}.new_serial_share"] == pytest.approx(0.2)
    assert (serial_share(1.0, 1.0, 4), serial_share(1.0, 0.25, 4)) == (1.0, 0.0)


def test_a_load_is_told_by_medians():
    found = summarise(ROWS)
    assert found["loaded.old.slowdown"] == pytest.approx(2.0)
    assert found["loaded.new.slowdown"] == pytest.approx(1.5)
    assert found["loaded.x_old"] == pytest.approx(0.08 / 0.03)


def test_without_an_older_revision_there_are_its_own_figures_and_no_ratios():
    found = summarise([row for row in ROWS if row["which"] == NEW])
    assert found["a.new@20.psnr_db"] == 31.7
    assert found["loaded.new.slowdown"] == pytest.approx(1.5)
    assert not any("old" in key for key in found)
    assert summarise([]) == {}


def test_patience_is_of_the_longest_new_end_over_the_one_before_it():
    found = summarise(ROWS)
    assert found["a.new@60-new@20.psnr_db"] == pytest.approx(1.3)
    assert found["least.new@60-new@20.psnr_db"] == found["a.new@60-new@20.psnr_db"]
    assert not any(key.startswith("b.") and "-new@" in key for key in found)  # which has one new end


def test_the_page_has_every_table_and_names_both_revisions(tmp_path):
    write_page(tmp_path / "speed.md", DOCUMENT)
    text = (tmp_path / "speed.md").read_text()
    assert "revision NEW against OLD, a processor" in text
    assert "| a | new@20 | 31.70 | 26.50 | 0.0120 | 20.5 | 100 | 48,000 | 500 | 0.000 |" in text
    assert "| least | new@20 - old@60 | -0.50 | -0.50 |  |" in text
    assert "| a | new@20 - old@20 | +3.30 |" in text
    assert "| least | new@60 - old@best | +1.80 |" in text
    assert "| a | whole | 29 to 31 | 60 | 20 |\n| a | whole | 32 to 33 | - | 60 |" in text
    assert "| a | whole | 28 | 20 | 20 |" in text
    assert "| a | 60 | points | 8.00 | 4.00 | 2.00 |" in text
    assert f"| {SMALL.label} | 2 | 30.0 | 12.0 | 2.50 | 2.00 | 0.50 | 0.20 |" in text
    assert f"| {SMALL.label} | 2 | renderer | 10.00 | 4.00 | 2.50 |" in text
    assert "Adam" not in text  # one revision alone has it
    assert "| new | 20.0 | 30.0 | 1.50 |" in text
    assert "- one seed" in text


def test_a_page_of_one_revision_leaves_out_what_compares():
    rows = [row for row in ROWS if row["which"] == NEW]
    text = page(DOCUMENT | {"rows": rows, "summary": summarise(rows)})
    assert "## Ends of runs" in text
    assert "| a | new@60 - new@20 |" in text
    assert "old@" not in text
    assert "## Stages" not in text


@pytest.mark.parametrize("left_out", ["", OLD, "dynamic_psnr_db"])
def test_the_picture_has_a_panel_for_each_clip(left_out, tmp_path):
    rows = [{k: v for k, v in row.items() if k != left_out} for row in ROWS if row["which"] != left_out]
    PLOTS["speed"](tmp_path / "speed.png", DOCUMENT | {"rows": rows})
    assert (tmp_path / "speed.png").stat().st_size > 10_000


def test_a_document_without_runs_has_no_picture(tmp_path):
    PLOTS["speed"](tmp_path / "speed.png", DOCUMENT | {"rows": [r for r in ROWS if r["part"] != "ends"]})
    assert not (tmp_path / "speed.png").exists()


def contenders(*names: str) -> list[Contender]:
    return [Contender(name, (name,), Path(name), f"the {name} one") for name in names]


def recorded() -> Path:
    return Path("recording")


def clip(name: str = "a", recorded=recorded, runs=SHORT.runs) -> Clip:
    return Clip(name, 1, runs, recorded)


@pytest.fixture
def made(monkeypatch):
    """Every run and every turn of steps that the bench asks for, none of which is done."""
    calls: list[str] = []

    def told(contender, recording, out, budget_s, ended):
        calls.append(f"{contender.name}@{budget_s:g}")
        assert ended(out) == {}
        disturbed = contender.name == OLD and calls.count(calls[-1]) == 1
        return end("a", contender.name, budget_s, 30.0, 25.0) | {"stolen": 0.5 if disturbed else 0.0}

    class Told:
        def __init__(self):
            self.revisions = {OLD: "0", NEW: "1"}

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        def steps(self, contender, size, threads):
            calls.append(f"{contender.name} steps")
            return [{"step": s, "renderer": s / 2} for s in (0.02, 0.01, 0.03)]

    monkeypatch.setattr(bench, "run_to_end", told)
    monkeypatch.setattr(bench, "Steppers", Told)
    monkeypatch.setattr(Contender, "revision", lambda self: "an older one")
    return calls


def test_both_revisions_are_run_in_turns_and_nothing_twice(made, tmp_path):
    bench = SpeedBench(contenders(OLD, NEW), [clip()], tmp_path, silent, SHORT)
    document = bench.run()
    stepped = [call for call in made if call.endswith("steps")]
    assert stepped == ["old steps", "new steps"] * (len(stepped) // 2)
    assert made[len(stepped) :] == ["old@6", "old@6", "new@2", "new@6"]  # the old one was disturbed
    assert [row["stolen"] for row in document.rows if row["part"] == "ends"] == [0.0] * 3
    assert {(row["which"], row["loaded"]) for row in document.rows if row["part"] == "loaded"} == {
        (which, load) for which in (OLD, NEW) for load in (False, True)
    }
    assert {row["part_s.renderer"] for row in document.rows if row["part"] != "ends"} == {0.005}
    assert all(row["seconds"] > 0 and row["command"] and row["revision"] for row in document.rows)
    assert document.summary["a.new@2-old@6.psnr_db"] == 0.0
    made.clear()
    again = SpeedBench(contenders(OLD, NEW), [clip()], tmp_path, silent, SHORT).run()
    assert made == []
    assert (again.rows, again.summary) == (document.rows, document.summary)


def test_each_run_is_shown_before_it_is_deleted(made, tmp_path):
    shown, both = [], contenders(OLD, NEW)
    SpeedBench(both, [clip()], tmp_path, silent, Extent(SHORT.runs), seen=shown.append).run()
    assert made == ["old@6", "old@6", "new@2", "new@6"]  # no single steps were asked for
    assert shown == [
        (clip(), by, budget_s, tmp_path / f"a-{by.name}.run")
        for by, budget_s in ((both[0], 6.0), (both[0], 6.0), (both[1], 2.0), (both[1], 6.0))
    ]


def test_other_code_is_measured_again_on_both_sides(made, tmp_path, monkeypatch):
    SpeedBench(contenders(OLD, NEW), [clip()], tmp_path, silent, SHORT).run()
    whole = len(made)
    made.clear()
    monkeypatch.setattr(bench, "code_revision", lambda: "another")
    SpeedBench(contenders(OLD, NEW), [clip()], tmp_path, silent, SHORT).run()
    assert len(made) == whole


def test_without_an_older_command_this_revision_is_measured_alone(made, tmp_path):
    document = SpeedBench(contenders(NEW), [clip()], tmp_path, silent, SHORT).run()
    assert {row["which"] for row in document.rows} == {NEW}
    assert any("--against" in omission for omission in document.omissions)


def test_what_failed_and_what_had_no_time_is_named(made, tmp_path, monkeypatch):
    def refused():
        raise AcquisitionError("found no path tracer")

    def failed(contender, *_):
        raise ReconstructionError("found exit code 1", where=contender.said)

    late = SpeedBench(contenders(OLD, NEW), [clip()], tmp_path, silent, SHORT, lambda: False).run()
    assert made == late.rows == []
    assert "a-new@2: no time was left" in late.omissions
    monkeypatch.setattr(bench, "run_to_end", failed)
    document = SpeedBench(contenders(NEW), [clip(), clip("b", refused)], tmp_path, silent, SHORT).run()
    assert "a-new@2: the new one: found exit code 1" in document.omissions
    assert "b-new@2: found no path tracer" in document.omissions
    assert document.rows  # the steps


def test_the_whole_bench_has_the_budgets_that_are_asked_for():
    budgets = {which: sorted(budget for name, budget in FULL.runs if name == which) for which in (OLD, NEW)}
    assert budgets == {OLD: [20, 40, 60], NEW: [10, 20, 40, 60, 300]}
    assert {(size.gaussians, size.width) for size in FULL.steps} == {(20_000, 400), (48_000, 400), (96_000, 1000)}
    assert FULL.turns >= 5
    assert {budget for _, budget in LARGE.runs} == {180, 600}
    assert Clip("a", 1, LARGE.runs, Path, LARGE_SIZE).name == "a-1-1000x1000"
    assert max(budget for _, budget in QUICK.runs) < 10
