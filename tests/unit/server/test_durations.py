"""Expected seconds follow the planes that a job reads, from one to a million."""

import json

import pytest

from server.services.durations import Durations
from server.store.entries import Listed

PLANES = {"short": 400, "long": 1_000_000, "one": 1, "twice": 800, "gone": None}


def listed(kind: str, seconds: dict[str, float], **request: object) -> Listed:
    progress = json.dumps({"seconds": seconds})
    return Listed("j", kind, "", None, None, None, 100, json.dumps(request), progress, "done", None)


class Kept:
    """The jobs that are done."""

    def __init__(self, *jobs: Listed) -> None:
        self.jobs = jobs

    def finished(self, entry_type: str, limit: int) -> list[Listed]:
        return [job for job in self.jobs if job.type == entry_type]


def whole(job: Listed, *done: Listed) -> float | None:
    return Durations(Kept(*done), PLANES.__getitem__).whole(job)  # type: ignore[arg-type]


@pytest.mark.parametrize(("capture", "expected"), [("short", 2.0), ("twice", 4.0), ("long", 5000.0), ("one", 0.005)])
def test_a_verification_takes_as_long_as_its_planes(capture: str, expected: float) -> None:
    done = listed("verify", {"verify": 2.0}, capture="short")
    assert whole(listed("verify", {}, capture=capture), done) == pytest.approx(expected)


def test_what_nobody_knows_the_length_of_is_as_usual() -> None:
    known, gone = (listed("verify", {"verify": 2.0}, capture=name) for name in ("short", "gone"))
    assert whole(listed("verify", {}, capture="gone"), known) == 2.0
    assert whole(listed("verify", {}, capture="long"), gone) == 2.0
    assert whole(listed("verify", {}, capture="long")) is None


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ({"from_tick": None, "to_tick": None}, 6 * 2500.0),
        ({"from_tick": 0, "to_tick": 800}, 12.0),
        ({"from_tick": 999_600, "to_tick": None}, 6.0),
        ({"from_tick": 7, "to_tick": 8}, 6.0),  # one plane takes what a span does
    ],
)
def test_a_reconstruction_by_steps_takes_as_long_as_its_spans(part: dict, expected: float) -> None:
    seconds = dict.fromkeys(("plan", "poses", "images", "points", "train", "report"), 1.0)
    done = listed("reconstruct", seconds, capture="short", steps=100)
    assert whole(listed("reconstruct", {}, capture="long", steps=100, **part), done) == pytest.approx(expected)


def test_a_budget_bounds_all_but_the_report() -> None:
    seconds = dict.fromkeys(("plan", "poses", "images", "points", "train", "report"), 1.0)
    done = listed("reconstruct", seconds, capture="short", budget_s=60)
    assert whole(listed("reconstruct", {}, capture="twice", budget_s=60), done) == 62.0


def test_images_of_some_planes_do_not_grow_with_the_capture() -> None:
    done = listed("images", {"images": 3.0}, capture="short", ticks="0:10")
    assert whole(listed("images", {}, capture="long", ticks="0:10"), done) == 3.0


def test_looks_at_a_recording_that_is_written_count_for_nothing() -> None:
    seconds = dict.fromkeys(("plan", "poses", "images", "points", "train", "report"), 1.0)
    done = listed("reconstruct", seconds | {"follow": 500.0}, capture="short", budget_s=60, follow=True)
    assert whole(listed("reconstruct", {}, capture="twice", budget_s=60), done) == 62.0
