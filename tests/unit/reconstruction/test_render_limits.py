"""Tests that a picture or a film that no machine should be asked for is refused, before anything is rendered."""

import json

import pytest

from reconstruction.rendering.limits import frames_to_render
from rigs.errors import RigError
from rigs.exchange.nerfstudio import Frame, dump_frames
from rigs.toml import catalog_rig

RIG = catalog_rig("ci3x3")


def cameras(tmp_path, size, frames):
    camera = RIG.cameras[0].scaled(*size)
    path = tmp_path / "transforms.json"
    path.write_text(dump_frames([Frame(camera, 0.01 * n) for n in range(frames)], ["p.png"] * frames))
    return path


def test_frames_of_usual_sizes_are_read(tmp_path):
    assert len(frames_to_render(cameras(tmp_path, (1000, 1000), 12))) == 12


@pytest.mark.parametrize("size", [(100_000, 100_000), (8192, 4097)])
def test_a_picture_that_is_too_large_is_refused(tmp_path, size):
    with pytest.raises(RigError, match=rf"frame 0: found a picture of {size[0]}x{size[1]}, expected at most 33554432"):
        frames_to_render(cameras(tmp_path, size, 1))


def test_frames_that_are_too_many_are_refused(tmp_path):
    path = cameras(tmp_path, (5000, 5000), 1)
    document = json.loads(path.read_text())
    document["frames"] *= 172
    path.write_text(json.dumps(document))
    with pytest.raises(RigError, match=r"found 172 frames of 4300000000 pixels together"):
        frames_to_render(path)
