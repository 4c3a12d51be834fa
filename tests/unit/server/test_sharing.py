"""Compares more workers with one: the tasks of a measured recording, and the shares of one worker's time."""

import pytest
from maintenance.sharing import STAGES, least_s, summarise, tasks_of

SECONDS = {f"seconds.{stage}": 2.0 for stage in STAGES}
LONG = {
    "rows": [
        {"part": "whole", "clip": "short", "planes": 4000, "seconds.train": 50.0, **SECONDS},
        {"part": "whole", "clip": "long", "planes": 20000, "seconds.train": 30.0, **SECONDS},
        {"part": "span", "clip": "short", "seconds": 40.0},
        {"part": "span", "clip": "long", "seconds": 10.0},
        {"part": "span", "clip": "long", "psnr_db": 30.0},
        {"part": "span", "clip": "long", "seconds": 12.0},
        {"part": "alone", "clip": "long", "seconds": 60.0},
    ]
}


def test_the_tasks_are_those_of_the_longest_recording_and_what_rests_is_the_still_scene():
    clip, tasks = tasks_of(LONG)
    assert clip == "long"
    assert tasks == {**dict.fromkeys(STAGES, 2.0), "still": 8.0, "000000": 10.0, "000001": 12.0}


def test_spans_that_were_joined_are_one_task():
    joined = [{"part": "span", "clip": "long", "seconds": 4.0, "span": span} for span in (0, 1, 1)]
    whole = [row for row in LONG["rows"] if row["part"] == "whole"]
    assert tasks_of({"rows": [*whole, *joined]})[1].items() >= {"000000": 4.0, "000001": 8.0, "still": 18.0}.items()


def test_each_number_of_workers_is_compared_with_one_of_its_kind():
    rows = [
        {"part": "worked", "workers": 1, "seconds": 100.0},
        {"part": "worked", "workers": 2, "seconds": 55.0},
        {"part": "played", "workers": 1, "seconds": 600.0},
        {"part": "played", "workers": 8, "seconds": 120.0},
    ]
    assert summarise(rows) == {"worked.2": pytest.approx(0.55), "played.8": pytest.approx(0.2)}


def test_the_least_is_told_where_it_is_known():
    rows = [
        {"part": "played", "workers": 1, "seconds": 600.0, "tasks_s": 500.0, "least_s": 500.0},
        {"part": "played", "workers": 8, "seconds": 120.0, "tasks_s": 500.0, "least_s": 100.0},
    ]
    assert summarise(rows)["played.8.least"] == pytest.approx(0.2)


@pytest.mark.parametrize(("workers", "least"), [(1, 40.0), (2, 30.0), (3, 28.0), (9, 28.0)])
def test_no_schedule_is_shorter_than_what_waits_and_the_longest_share_of_the_spans(workers: int, least: float):
    tasks = {"plan": 10.0, "still": 8.0, "000000": 10.0, "000001": 10.0, "000002": 2.0}
    assert least_s(tasks, workers) == least


def test_a_recording_without_spans_takes_its_other_tasks():
    assert least_s({"plan": 10.0, "still": 8.0}, 4) == 18.0
