"""A recording is looked at while it is written: a scene is there before its end, and changes nothing of the run."""

import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from acquisition.errors import BadRecordingError
from acquisition.progress import silent
from acquisition.recording.reader import Recording
from acquisition.recording.writer import RecordingWriter
from reconstruction.errors import BadRunError
from reconstruction.pipeline import follow as module
from reconstruction.pipeline.budget import StoppedError
from reconstruction.pipeline.follow import LOOK, LOOKS, follow
from reconstruction.pipeline.stages import reconstruct
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.training.checkpoint import load_cloud

LOOK_PLANES, AT_FIRST = 80, 170  # planes of a look, and those written before anybody waits for the first one
CONFIG = ReconstructionConfig(holdout="cam11", steps=12, budget_s=None, seed=1, gaussians=2000)


@pytest.fixture(autouse=True)
def short_looks(monkeypatch):
    monkeypatch.setattr(module, "PLANES", LOOK_PLANES)
    monkeypatch.setattr(module, "_PATIENCE_S", 0.5)
    monkeypatch.setattr(module, "_QUIET_S", 0.5)


class Rewriter:
    """Writes the planes of a finished recording anew, as far as it is told."""

    def __init__(self, source, path):
        self.source, self.writer = Recording.open(source), RecordingWriter(path, Recording.open(source).rig, 0)

    def __enter__(self):
        self.writer.__enter__()
        layouts = [(camera.id, camera.layout) for camera in self.source.manifest.cameras]
        self.streams = [self.writer.stream(camera_id, layout) for camera_id, layout in layouts]
        self.writer.mark("recording", "line")
        return self

    def __exit__(self, *error):
        self.writer.__exit__(*error)

    def write(self, first, last):
        for stream in self.streams:
            stream.append(np.array(self.source.stream(stream.camera_id).window(first, last)))

    def commit(self):
        for stream in self.streams:
            stream.close()
        self.writer.commit([stream.entry() for stream in self.streams], "line")


def awaited(is_there):
    while not is_there():
        time.sleep(0.02)


@pytest.mark.slow
def test_the_first_look_can_be_played_before_the_last_plane_comes_and_the_run_is_as_ever(long_recording, tmp_path):
    path, out = tmp_path / "rec", tmp_path / "run"
    with Rewriter(long_recording, path) as rewriter, ThreadPoolExecutor(1) as aside:
        rewriter.write(0, AT_FIRST)
        following = aside.submit(follow, path, out, CONFIG, silent)
        awaited(lambda: (out / "viewer.json").exists() or following.done())
        assert not following.done()
        assert (out / "preview.png").exists()
        first = json.loads((out / "viewer.json").read_text())
        assert first["moving"] > 0
        rewriter.write(AT_FIRST, rewriter.source.planes)
        rewriter.commit()
        looks = following.result()
    assert looks[0].last_tick - looks[0].first_tick == LOOK_PLANES - 1
    assert looks[0].failed is None
    assert 0 < looks[0].picture_s <= looks[0].scene_s
    assert len(json.loads((out / LOOKS).read_text())["looks"]) == len(looks)
    assert not (out / LOOK).exists()

    followed = reconstruct(path, out, CONFIG, lambda _: silent, last="train")
    alone = reconstruct(long_recording, tmp_path / "alone", CONFIG, lambda _: silent, last="train")
    expected, found = (dict(load_cloud(run.checkpoint).tensors()) for run in (alone, followed))
    assert expected.keys() == found.keys()
    assert all(tensor.equal(found[name]) for name, tensor in expected.items())


def test_one_that_is_whole_gets_no_look_and_one_of_a_part_is_refused(long_recording, tmp_path):
    assert follow(long_recording, tmp_path / "run", CONFIG, silent) == []
    part = ReconstructionConfig(steps=1, budget_s=None, from_tick=3)
    with pytest.raises(BadRunError, match="leave out the ticks"):
        follow(long_recording, tmp_path / "part", part, silent)


def test_one_that_never_begins_or_whose_writer_died_is_told(long_recording, tmp_path):
    with pytest.raises(BadRecordingError, match="found nothing there within"):
        follow(tmp_path / "never", tmp_path / "run", CONFIG, silent)
    with Rewriter(long_recording, tmp_path / "rec") as rewriter:
        rewriter.write(0, 20)
        left = rewriter.writer.folder.rename(tmp_path / "left")
    left.rename(tmp_path / "rec.partial")
    with pytest.raises(BadRecordingError, match="finalise"):
        follow(tmp_path / "rec", tmp_path / "run2", CONFIG, silent)


def test_it_waits_for_a_writer_that_is_quiet_and_obeys_an_order_to_stop(long_recording, tmp_path):
    stop = threading.Event()
    with Rewriter(long_recording, tmp_path / "rec") as rewriter, ThreadPoolExecutor(1) as aside:
        rewriter.write(0, 20)
        following = aside.submit(follow, tmp_path / "rec", tmp_path / "run", CONFIG, silent, stop.is_set)
        time.sleep(1.0)  # longer than a writer that is not there is waited for
        assert not following.done()
        stop.set()
        with pytest.raises(StoppedError):
            following.result()


@pytest.mark.slow
def test_a_look_that_fails_is_noted_and_the_next_one_made(long_recording, tmp_path, monkeypatch):
    made = []

    def refuse_the_first(*given, **named):
        made.append(given)
        if len(made) == 1:
            raise BadRunError("found nothing that moves", "something")
        return reconstruct(*given, **named)

    monkeypatch.setattr(module, "reconstruct", refuse_the_first)
    with Rewriter(long_recording, tmp_path / "rec") as rewriter, ThreadPoolExecutor(1) as aside:
        rewriter.write(0, AT_FIRST)
        following = aside.submit(follow, tmp_path / "rec", tmp_path / "run", CONFIG, silent)
        awaited(lambda: (tmp_path / "run" / LOOKS).exists() or following.done())
        rewriter.write(AT_FIRST, rewriter.source.planes)
        rewriter.write(0, AT_FIRST)  # again, so that there are enough for a second look
        awaited(lambda: (tmp_path / "run" / "viewer.json").exists() or following.done())
        rewriter.commit()
        looks = following.result()
    assert looks[0].failed == "found nothing that moves, expected something"
    assert looks[1].failed is None


def test_a_look_is_in_one_piece_and_takes_no_longer_than_it_may(long_recording, tmp_path, monkeypatch):
    asked = []

    def refused(*given, **named):
        asked.append(given[2])
        raise BadRunError("found a look", "none")

    monkeypatch.setattr(module, "reconstruct", refused)
    config = ReconstructionConfig(holdout="cam11", budget_s=600, span=LOOK_PLANES)
    with Rewriter(long_recording, tmp_path / "rec") as rewriter, ThreadPoolExecutor(1) as aside:
        rewriter.write(0, AT_FIRST)
        following = aside.submit(follow, tmp_path / "rec", tmp_path / "run", config, silent)
        awaited(lambda: asked or following.done())
        rewriter.write(AT_FIRST, rewriter.source.planes)
        rewriter.commit()
        following.result()
    assert (asked[0].span, asked[0].budget_s, asked[0].holdout) == (None, module.LOOK_S, "cam11")
    assert asked[0].to_tick - asked[0].from_tick == LOOK_PLANES
