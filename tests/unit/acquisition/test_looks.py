"""The log of looks has each evaluation scene that a bench showed once, with the day and reason of the first look."""

from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION, REALISTIC_EVALUATION, STRESS
from acquisition.scenes.looks import NO_REASON, add_looks, looks_of, read_looks


def document(*scenes, revision="abc", **more):
    return {"bench": "paper", "revision": revision, "rows": [{"scene": scene, **more} for scene in scenes]}


def test_rows_of_evaluation_and_stress_scenes_are_counted_and_no_others():
    seen = (EVALUATION[0], EVALUATION[0], STRESS[1], REALISTIC_EVALUATION[0], DEVELOPMENT[0])
    found = looks_of({**document(*seen), "rows": [*document(*seen)["rows"], {"part": "steps"}]}, "2026-01-02")
    assert [(look["scene"], look["runs"]) for look in found] == [
        (EVALUATION[0], 2),
        (STRESS[1], 1),
        (REALISTIC_EVALUATION[0], 1),
    ]
    assert all((look["day"], look["revision"], look["reason"]) == ("2026-01-02", "abc", NO_REASON) for look in found)


def test_a_span_is_no_look_of_its_own():
    rows = [{"scene": "pushed_blocks", "part": part, "revision": "abc"} for part in ("whole", "span", "span", "alone")]
    (found,) = looks_of(document() | {"rows": rows}, "d")
    assert found["runs"] == 2


def test_a_row_of_another_revision_is_a_look_of_that_revision():
    (found,) = looks_of(document(EVALUATION[0], revision="new") | {"rows": [{"scene": "fan", "revision": "old"}]}, "d")
    assert found["revision"] == "old"


def test_the_first_day_and_reason_stay_and_the_most_runs_count(tmp_path):
    file = tmp_path / "looks.jsonl"
    add_looks(file, looks_of(document("fan"), "2026-01-02", "a question"))
    add_looks(file, looks_of(document("fan", "fan", "runner"), "2026-01-03", "another"))
    fan, runner = read_looks(file)
    assert (fan["day"], fan["reason"], fan["runs"]) == ("2026-01-02", "a question", 2)
    assert (runner["day"], runner["reason"]) == ("2026-01-03", "another")


def test_no_look_leaves_no_log(tmp_path):
    add_looks(tmp_path / "looks.jsonl", looks_of(document(DEVELOPMENT[0]), "2026-01-02"))
    assert read_looks(tmp_path / "looks.jsonl") == []
    assert list(tmp_path.iterdir()) == []
