"""The parts of a training in spans: their order, their shares, what is due, and files that the first process makes."""

import fcntl
import os

import pytest
import torch

from reconstruction.pipeline.part_file import SILENT_S, PartFile
from reconstruction.run.parts import (
    LEAST_WEIGHT,
    STILL,
    STILL_WEIGHT,
    Failure,
    Part,
    PartFolder,
    parts_of,
    shares_of,
    span_name,
)

EVEN = {0: 0.3, 1: 0.3, 4: 0.3}  # shares of the pixels that three spans show


def names(parts):
    return [part.name for part in parts]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "images").mkdir()
    made = PartFolder(tmp_path)
    made.note(parts_of(EVEN))
    return made


def keep(folder, name, learn=lambda beat: {"content": torch.ones(2)}, **how):
    return PartFile(folder, name, **how).keep(learn)


def test_shares_are_of_all_weight_and_leave_nothing_out():
    shares = shares_of(parts_of({0: 0.2, 1: 0.2}))
    assert shares[STILL] == (0.0, STILL_WEIGHT / (STILL_WEIGHT + 2))
    assert shares[span_name(1)][1] == pytest.approx(1.0)
    assert shares_of(parts_of({})) == {STILL: (0.0, 1.0)}


def test_spans_that_show_more_come_first_and_weigh_more():
    still, *spans = parts_of({0: 0.1, 2: 0.6, 3: 0.2, 7: 0.3})
    assert still == Part(STILL, STILL_WEIGHT)
    assert names(spans) == [span_name(number) for number in (2, 7, 3, 0)]
    assert [part.weight for part in spans] == pytest.approx([2.0, 1.0, 2 / 3, 1 / 3])


def test_a_span_that_shows_next_to_nothing_has_time_for_its_points():
    *_, last = parts_of({0: 0.6, 1: 0.0006})
    assert last == Part(span_name(1), LEAST_WEIGHT)


def test_parts_are_noted_and_a_run_without_has_none(folder, tmp_path):
    assert folder.noted() == [Part(STILL, STILL_WEIGHT), Part("000000"), Part("000001"), Part("000004")]
    assert PartFolder(tmp_path / "other").noted() == []
    assert PartFolder(tmp_path / "other").due(()) == []


def test_the_still_scene_comes_first_and_all_spans_after_it(folder):
    assert names(folder.due(())) == [STILL]
    assert folder.due({STILL}) == []
    assert keep(folder, STILL)
    assert names(folder.due({STILL})) == ["000000", "000001", "000004"]
    assert names(folder.due({STILL, "000004"})) == ["000000", "000001"]
    assert keep(folder, "000000")
    assert names(folder.due({"000004"})) == ["000001"]


def test_a_part_that_was_given_up_can_be_tried_again(folder):
    keep(folder, STILL)
    folder.give_up("000000", Failure("found a fault", 3))
    assert folder.failure("000000") == Failure("found a fault", 3)
    assert folder.given_up() == {"000000"}
    keep(folder, "000000")
    assert folder.given_up() == set()
    folder.try_again("000000")
    assert folder.failure("000000") is None


def test_nothing_is_due_without_the_still_scene(folder):
    folder.give_up(STILL, Failure("found the dark", 1, bad_input=True))
    assert folder.due({STILL}) == []


def test_what_is_there_is_not_learnt_again(folder):
    assert keep(folder, STILL)
    assert not keep(folder, STILL, lambda beat: pytest.fail("learnt twice"))
    assert PartFile(folder, STILL).read()["content"].tolist() == [1, 1]


def test_a_late_result_is_dropped(folder):
    def late(beat):
        (folder.path / f"{STILL}.lock").unlink()  # as on another host, whose lock it does not see
        assert keep(folder, STILL, lambda beat: {"content": torch.zeros(1)})
        return {"content": torch.ones(1)}

    assert not keep(folder, STILL, late)
    assert PartFile(folder, STILL).read()["content"].tolist() == [0]
    assert [file.name for file in folder.path.glob(".*")] == []


def test_a_result_of_a_training_that_was_forgotten_is_dropped(folder):
    def late(beat):
        folder.forget()
        folder.path.mkdir()
        return {"content": torch.ones(1)}

    assert not keep(folder, STILL, late)
    assert list(folder.path.iterdir()) == []
    folder.forget()
    folder.forget()
    assert [path.name for path in folder.path.parent.iterdir()] == ["images"]


def test_one_that_gives_signs_of_life_is_waited_for(folder):
    waited = []

    def pause(seconds):
        waited.append(seconds)
        if len(waited) == 3:
            fcntl.flock(held, fcntl.LOCK_UN)

    folder.path.mkdir()
    held = os.open(folder.path / f"{STILL}.lock", os.O_CREAT | os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_EX)
    assert keep(folder, STILL, pause=pause)
    assert len(waited) == 3
    os.close(held)


def test_one_that_stands_still_is_passed_over_and_finds_the_part_there(folder):
    folder.path.mkdir()
    held = os.open(folder.path / f"{STILL}.lock", os.O_CREAT | os.O_RDWR)
    fcntl.flock(held, fcntl.LOCK_EX)
    late_s = os.fstat(held).st_mtime + SILENT_S + 1
    assert keep(folder, STILL, pause=lambda seconds: pytest.fail("waited"), clock=lambda: late_s)
    os.close(held)


def test_a_sign_of_life_is_one(folder):
    def learn(beat):
        lock = folder.path / f"{STILL}.lock"
        os.utime(lock, (0, 0))
        beat()
        assert lock.stat().st_mtime > 0
        return {}

    assert keep(folder, STILL, learn)


def test_what_fails_leaves_nothing(folder):
    with pytest.raises(ZeroDivisionError):
        keep(folder, STILL, lambda beat: {"content": 1 / 0})
    assert not PartFile(folder, STILL).is_there
    assert keep(folder, STILL)
