"""The paper bench's document as numbers, tables and diagrams."""

import numpy as np
import pytest
from maintenance.beside_the_paper import paper_table

from acquisition.bench_document import BenchDocument
from reconstruction.bench import figures
from reconstruction.bench.figures import relative_error
from reconstruction.bench.paper import methods as m
from reconstruction.bench.paper.bench import NOT_RUN
from reconstruction.bench.paper.diagrams import write_diagrams
from reconstruction.bench.paper.method import Batch, Effort, Protocol, Row, Table
from reconstruction.bench.paper.protocol import CHAIN, EQUAL, GAUSSIANS, RATES, SWEPT, VIEWS
from reconstruction.bench.paper.summary import gaps, summarise
from reconstruction.bench.paper.tables import measured_table, whole_tables, write_tables
from reconstruction.bench.training.bench import times_to
from reconstruction.bench.training.diagram import curve

STAGES = {f"seconds.{stage}": 1.0 for stage in ("plan", "poses", "images", "points", "train")}
SHORT, LONG = Effort(30.0), Effort(60.0)
TABLE = Table(
    "seen",
    "The held-out centre view",
    "True poses.",
    (
        Row("Ours", m.AUTO, "Spike4DGS"),
        Row("TFI + small 4DGS", m.TFI["4dgs-small"], "TFI + 4DGS"),
        Row("DUSt3R", None, "MSDI image + DUSt3R + 4DGS", "no checkpoint"),
    ),
)
PROTOCOL = Protocol(
    (TABLE,),
    (
        Batch("seen", ("fan", "traffic"), (SHORT, LONG)),
        Batch("seen", ("fan",), (SHORT,), ("auto",), seeds=(1, 2)),
    ),
)


def row(method, level, scene="fan", seed=101, effort="30"):
    end = float(effort)
    points = [(end / 4, level - 6), (end / 2, level - 2), (end, level)]
    machine = {"processor": "A chip", "threads": 2, "revision": "abc"}
    scores = {
        "gaussians": 48_000,
        "psnr_db": level,
        "dynamic_psnr_db": 28.0,
        "ssim": 0.9,
        "abs_rel": 0.05,
        "delta_1_25": 0.97,
        "steps_per_s": 20.0,
        "seconds": end,
    }
    curve = [{"seconds": s, "psnr_db": y, "abs_rel": 1 / y} for s, y in points]
    about = {"method": method, "scene": scene, "seed": seed, "effort": effort, "budget_s": end}
    return {**about, **machine, **scores, **STAGES, "curve": curve}


ROWS = [
    *(row("auto", 30.0 + seed - 102, seed=seed) for seed in (101, 102, 103)),
    row("auto", 33.0, "traffic"),
    row("auto", 35.0, effort="60"),
    row("tfi+4dgs-small", 25.0),
    row("tfi+4dgs-small", 27.0, "traffic"),
    row("tfi+4dgs-small", 28.0, effort="60"),
]


def document(rows=ROWS):
    found = BenchDocument("paper", rows=list(rows), omissions=["something: for a reason"])
    summarise(found, PROTOCOL)
    return found


def test_the_summary_is_of_means_over_recordings_and_of_pairs():
    found = document().summary
    assert found["seen.auto.psnr_db@30"] == pytest.approx((29 + 30 + 31 + 33) / 4)
    assert found["seen.auto.seconds@60"] == 60
    assert found["seen.tfi+4dgs-small.abs_rel@30"] == pytest.approx(0.05)
    assert gaps(ROWS, "auto", "tfi+4dgs-small", "30") == [29 - 25, 33 - 27]
    assert gaps(ROWS, "auto", "tfi+4dgs-small", "60") == [7]
    assert gaps(ROWS, "auto", "clean", "60") == []


def test_the_first_second_at_which_any_run_reached_a_level():
    rows = [row("auto", 30.0), row("auto", 30.0, effort="60"), row("auto", 20.0, "traffic")]
    assert times_to(rows, "auto", 28.0) == [15.0, None]
    assert times_to(rows, "none", 28.0) == []


def test_a_table_says_how_far_it_is():
    text = measured_table(TABLE, PROTOCOL, ROWS)
    lines = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    ours, longer, theirs, _ = lines[2:]
    spread = "29.0 to 33.0, ± 1.00"
    paper = "27.74 dB, SSIM 0.912, 1500 s |"
    assert ours == [
        "| Ours",
        "30 s",
        "30.75",
        "",
        spread,
        "28.00",
        "0.900",
        "0.0500",
        "0.970",
        "48,000",
        "30.0",
        "4 of 4",
        paper,
    ]
    assert longer[1:4] == ["60 s", "35.00", ""]
    assert longer[11] == "1 of 2"
    assert theirs[3:5] == ["-5.00", "25.0 to 27.0"]
    assert text.endswith("Without a measurement: DUSt3R.")
    assert "**2 runs were refused or failed; the omissions say which.**" in text
    nothing = measured_table(TABLE, PROTOCOL, [])
    assert nothing.endswith("Without a measurement: Ours; TFI + small 4DGS; DUSt3R.")


def test_a_table_that_lacks_runs_is_named_and_not_printed():
    whole = document().to_json()
    assert "(`seen`)" in whole_tables(whole, PROTOCOL)[0]
    lacking = whole | {"omissions": [f"seen, Ours: {NOT_RUN} (fan-101 @30)", "something: for a reason"]}
    assert whole_tables(lacking, PROTOCOL) == ["Tables that still lack runs, and are not printed: seen."]


def test_results_of_other_code_are_counted_as_such():
    text = measured_table(TABLE, PROTOCOL, [*ROWS[:3], ROWS[3] | {"kept": True}])
    assert "4 of 4, 1 of other code" in text


def test_figures_of_other_benches_stand_beside_the_papers():
    found = {"natural.rotation_deg": 0.0097, "natural.translation_percent": 0.0108, "natural.seconds": 4.92}
    text = paper_table("poses", {"summary": found | {"msdi.rotation_deg": 0.1}})
    assert "| natural calibration (ours) | 0.010 deg, 0.011 %, 4.92 s | - |" in text
    assert "| small MSDI alone | 0.100 deg | 0.94 deg, 2.1 %, 9 s |" in text
    assert "TFI + DUSt3R (no DUSt3R checkpoint" in text
    assert "small MSDI, adjusted (not in the document)" in text


def test_all_tables_stand_in_one_file(tmp_path):
    found = document().to_json()
    found["omissions"].append(f"other, Ours: {NOT_RUN}")
    write_tables(tmp_path / "paper.md", found, PROTOCOL)
    text = (tmp_path / "paper.md").read_text()
    assert "A chip, 2 threads" in text
    assert "## Omissions\n\n- something: for a reason\n\n## Sittings" in text


def test_the_error_behind_a_psnr():
    assert relative_error([20.0, 40.0]) == pytest.approx([0.1, 0.01])


def of(method):
    return [row for row in ROWS if row["method"] == method]


def test_a_curve_is_that_of_the_longest_runs_on_most_scenes():
    seconds, errors = curve([r for r in of("tfi+4dgs-small") if r["scene"] == "fan"])
    assert seconds.tolist() == [15, 30, 60]
    np.testing.assert_allclose(errors, relative_error([[22.0, 26.0, 28.0]]))
    seconds, errors = curve(of("tfi+4dgs-small"))
    assert seconds.tolist() == [7.5, 15, 30]
    np.testing.assert_allclose(errors, relative_error([[19.0, 23.0, 25.0], [21.0, 25.0, 27.0]]))


def test_a_picture_for_each_question_that_has_an_answer(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "DPI", 40)
    swept = [row(name, 28.0) for name in ("auto.views3", "auto.drop1000", "auto.reintegrate1000", "auto.gaussians6000")]
    methods = [line.method for line in CHAIN.rows if line.method]
    changed = [row(method.name, 20.0 + place) | {"effort": EQUAL.label} for place, method in enumerate(methods)]
    whole = document([*ROWS, *swept, *changed]).to_json()
    found = write_diagrams(tmp_path, whole)
    names = {path.stem.removeprefix("paper-") for path in found}
    assert names == {"chain", "stages", "gaussians", "views", "rates"}
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in found)
    whole["omissions"] += [f"{name}, Ours: {NOT_RUN}" for name in ("chain", "views")]
    found = write_diagrams(tmp_path, whole)
    assert {path.stem.removeprefix("paper-") for path in found} == {"gaussians", "rates"}
    assert write_diagrams(tmp_path, document([]).to_json()) == []


def test_diagrams_name_each_swept_method_as_the_tables_do() -> None:
    rows = [row for table in (VIEWS, RATES, GAUSSIANS) for row in table.rows if row.method]
    swept = {row.method.name.split(".")[0]: row.label for row in rows if row.method}
    assert swept.keys() == SWEPT.keys()
    assert all(SWEPT[name] in label for name, label in swept.items() if name != "auto")
