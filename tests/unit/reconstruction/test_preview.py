import copy
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from reconstruction.pipeline import preview as module
from reconstruction.pipeline.preview import Preview
from reconstruction.report import pictures
from reconstruction.report.display import grey
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from reconstruction.training.checkpoint import model_from_state


class Clock:
    """A clock that stands still but for what a test adds."""

    now = 100.0

    def __call__(self) -> float:
        return self.now


def run_of(path: Path, holdout: str | None) -> RunFolder:
    return RunFolder.start(
        path / "run", ReconstructionConfig(holdout=holdout, budget_s=None, steps=9), path / "recording", "none"
    )


@pytest.fixture
def scene(scene_with):
    return scene_with("linear")


def drawn(run: RunFolder) -> np.ndarray:
    return cv2.imread(str(run.path / "preview.png"), cv2.IMREAD_GRAYSCALE)


@pytest.mark.parametrize(("holdout", "shown"), [("cam02", "cam02"), (None, "cam01")])
def test_it_shows_the_model_as_the_held_out_or_the_middle_camera_would_see_it(scene, tmp_path, holdout, shown):
    run = run_of(tmp_path, holdout)
    Preview(run, scene.rig, scene.white, Clock()).keep(lambda: scene.cloud, 7)
    seen = scene.cloud.look(scene.rig.camera(shown), scene.cloud.clip.middle_s)
    assert np.array_equal(drawn(run), grey(seen.intensity, scene.white))
    assert json.loads((run.path / "preview.json").read_text()) == {"camera": shown, "steps": 7}


def test_it_leaves_the_model_as_it_is(scene, tmp_path):
    state = copy.deepcopy(scene.cloud.state())
    Preview(run_of(tmp_path, "cam01"), scene.rig, scene.white, Clock()).draw(scene.cloud, 0)
    assert all(before.equal(dict(scene.cloud.tensors())[name]) for name, before in state["tensors"].items())
    assert not any(tensor.requires_grad for _, tensor in model_from_state(state).tensors())


def test_large_pictures_are_drawn_at_half_the_size(scene, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_PX", 64 * 41 - 1)
    run = run_of(tmp_path, "cam01")
    Preview(run, scene.rig, scene.white, Clock()).draw(scene.cloud, 0)
    assert drawn(run).shape == (20, 32)


def steps_drawn(scene, path: Path, monkeypatch, drawing_s: float, until_s: float) -> list[float]:
    """Return the seconds after the first picture at which others follow, of steps that take a tenth of a second."""
    clock, found = Clock(), []
    one = Preview(run_of(path, "cam01"), scene.rig, scene.white, clock)

    def look(*_: object) -> object:
        clock.now += drawing_s
        found.append(clock.now)
        return view

    view = scene.cloud.look(scene.rig.cameras[0], 0.0)
    monkeypatch.setattr(type(scene.cloud), "look", look)
    while not found or clock.now < found[0] + until_s:
        one.keep(lambda: scene.cloud, 0)
        clock.now += 0.1
    return [at - found[0] for at in found[1:]]


def test_pictures_come_soon_and_then_less_and_less_often(scene, tmp_path, monkeypatch):
    followed = steps_drawn(scene, tmp_path, monkeypatch, 0.01, 60)
    gaps, least = np.diff([0, *followed]), np.maximum(module.SOON_S, module.GROWTH * np.array([0, *followed[:-1]]))
    assert np.all((gaps >= least - 1e-6) & (gaps <= least + 0.13))
    assert followed[0] < 1.2
    assert 8 <= len(followed) <= 11


def test_pictures_take_a_hundredth_of_the_time_but_for_a_tenth_of_a_second(scene, tmp_path, monkeypatch):
    drawing_s = 0.5
    followed = steps_drawn(scene, tmp_path, monkeypatch, drawing_s, 400)
    assert followed
    for number, at_s in enumerate(followed, 1):
        assert number * drawing_s <= module.FREE_S + module.SHARE * (at_s + drawing_s)


def test_a_training_that_is_done_again_begins_without_a_picture(scene, tmp_path):
    run = run_of(tmp_path, "cam01")
    Preview(run, scene.rig, scene.white, Clock()).draw(scene.cloud, 3)
    run.forget(["report"], 1)
    assert (run.path / "preview.png").exists()
    run.forget(["train", "report"], 2)
    assert not list(run.path.glob("preview*"))
