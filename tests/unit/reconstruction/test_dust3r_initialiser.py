import argparse
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
import torch

from acquisition.scenes.catalog import build_scene
from acquisition.scenes.misplaced import misplaced
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.initialization.dust3r.initialiser import (
    dust3r,
    dust3r_with,
    padded_images,
    predicted,
)
from reconstruction.initialization.geometry import toned
from reconstruction.metrics.poses import pose_errors
from reconstruction.networks.dust3r.network import Architecture, Dust3r, PointMap
from rigs.toml import catalog_rig

DISTANCE_M = 1.8
W, H = 200, 125  # not a multiple of 16
SMALL = Architecture(16, 1, 2, 16, 1, 2, head="linear")


@pytest.fixture(scope="module")
def rig():
    """The true one."""
    return catalog_rig("lab3x3").scaled(W, H).only(["cam00", "cam02", "cam11", "cam20", "cam22"])


@pytest.fixture(scope="module")
def frames(rig):
    """Light and depth of one instant."""
    scene = build_scene("fan_and_ball", 1)
    return {c.id: scene.render(c, np.array([1e-3]), samples=1) for c in rig.cameras}


@pytest.fixture(scope="module")
def images(frames):
    return MappingProxyType({c: frame.intensity[0] for c, frame in frames.items()})


class Oracle(Dust3r):
    """Knows each image and what it shows: true points with some noise, at a scale of the pair's own, as padded."""

    def __init__(self, rig, frames, views):
        super().__init__(SMALL)
        tones = toned({c: frames[c].intensity[0] for c in views})
        self.known, (top, left) = padded_images([tones[c] for c in views], SMALL.patch_px)
        self.cameras = [rig.camera(c) for c in views]
        self.points = []
        for camera in self.cameras:
            rows, columns = np.meshgrid(*(np.arange(n) + 0.5 for n in self.known.shape[-2:]), indexing="ij")
            x, y = (columns - left - camera.cx) / camera.fx, (rows - top - camera.cy) / camera.fy
            depth = np.pad(frames[camera.id].depth[0], ((top, 3 - top), (left, 8 - left)), mode="edge")
            in_cam = np.stack([x, y, np.ones_like(x)], axis=-1) * depth[..., None]
            self.points.append(camera.cam_from_rig.inverse().apply(in_cam))
        self.rng = np.random.default_rng(0)

    def encode(self, images):
        which = [int(torch.stack([(image - known).abs().mean() for known in self.known]).argmin()) for image in images]
        return torch.tensor(which, dtype=torch.float32)[:, None, None]

    def forward(self, first, second, grid):
        assert grid == (8, 13)
        sides = []
        for a, b in zip(first.flatten().int().tolist(), second.flatten().int().tolist(), strict=True):
            scale = self.rng.uniform(0.5, 2)
            pose = self.cameras[a].cam_from_rig
            sides.append([scale * pose.apply(self.points[view]) for view in (a, b)])
        maps = torch.from_numpy(np.array(sides)).float()
        maps *= 1 + 0.005 * torch.from_numpy(self.rng.normal(size=(*maps.shape[:-1], 1)))
        return tuple(PointMap(maps[:, k], torch.full(maps.shape[0:1] + maps.shape[2:4], 5.0)) for k in (0, 1))


def test_true_point_maps_put_the_cameras_in_their_places(rig, frames, images):
    drawn = misplaced(rig, 2.0, seed=1).cameras
    lenses = zip(drawn, rig.cameras, strict=True)
    nominal = replace(rig, cameras=tuple(replace(c, fx=true.fx, fy=true.fy) for c, true in lenses))
    network = Oracle(rig, frames, rig.ids)
    steps = []
    found = dust3r_with(
        network,
        nominal,
        images,
        lambda fraction, message: steps.append((fraction, message)),
    )
    errors = pose_errors(found.rig, rig, DISTANCE_M)
    assert pose_errors(nominal, rig, DISTANCE_M).rotation_deg > 1
    assert errors.rotation_deg < 0.05
    assert errors.translation_percent < 0.1
    assert errors.focal_percent < 0.1
    assert found.report["method"] == "dust3r"
    assert found.report["focal"] == "rig"
    assert found.report["pairs"] == 20
    assert found.report["kept_nominal"] == []
    assert steps == sorted(steps, key=lambda step: step[0])
    assert steps[-1][0] == 1.0


def test_points_lie_on_the_scene_in_the_frame_of_the_rig(rig, frames, images):
    found = dust3r_with(Oracle(rig, frames, rig.ids), rig, images)
    camera = rig.camera("cam11")
    in_cam = camera.cam_from_rig.apply(found.points)
    pixel = in_cam @ camera.K.T
    column, row = (np.floor(pixel[:, k] / pixel[:, 2]).astype(int) for k in (0, 1))
    inside = (column >= 0) & (column < W) & (row >= 0) & (row < H)
    off = np.abs(in_cam[inside, 2] / frames["cam11"].depth[0][row[inside], column[inside]] - 1)
    assert inside.sum() > 2000
    assert np.median(off) < 0.01
    assert found.points.shape == (len(found.confidence), 3)
    assert found.confidence.min() > 0
    assert found.report["points"] == len(found.points)


def test_a_camera_without_image_keeps_its_place(rig, frames, images):
    nominal = misplaced(rig, 1.0, seed=2)
    views = [c for c in rig.ids if c != "cam20"]
    found = dust3r_with(Oracle(rig, frames, views), nominal, {c: images[c] for c in views})
    assert found.report["kept_nominal"] == ["cam20"]
    assert found.rig.ids == rig.ids
    assert np.array_equal(found.rig.camera("cam20").cam_from_rig.matrix, nominal.camera("cam20").cam_from_rig.matrix)
    assert {c.fx for c in found.rig.cameras} == {nominal.cameras[0].fx}


def test_the_network_sees_padded_pairs_and_its_pixels_are_the_images(images):
    torch.manual_seed(0)
    network = Dust3r(SMALL)
    tones = list(toned(images).values())
    rows, columns = np.array([0, 60, 124]), np.array([0, 100, 199])
    edges = [(0, 1), (2, 1), (1, 3), (4, 0), (3, 2)]
    pairs = predicted(network, tones, edges, (rows, columns))
    assert [(p.first, p.second) for p in pairs] == edges
    for pair in (pairs[1], pairs[4]):
        both = []
        for view in (pair.first, pair.second):
            image = np.pad(tones[view], ((1, 2), (4, 4)), mode="edge") * 2 - 1
            both.append(network.encode(torch.from_numpy(image).expand(1, 3, 128, 208)))
        with torch.no_grad():
            maps = network(*both, (8, 13))
        for side in (0, 1):
            expected = maps[side].points[0, rows + 1, columns + 4].detach().numpy()
            assert np.allclose(pair.points[side], expected, atol=1e-5)
            assert np.allclose(
                pair.confidence[side], maps[side].confidence[0, rows + 1, columns + 4].detach(), atol=1e-5
            )


def test_images_of_the_lab_are_padded_to_whole_patches():
    images, margins = padded_images([np.full((250, 400), 0.25, np.float32)] * 2, 16)
    assert images.shape == (2, 3, 256, 400)
    assert margins == (3, 0)
    assert images.unique().tolist() == [-0.5]


def test_tones_are_square_roots_under_one_white():
    dim, bright = np.full((4, 4), 0.09, np.float32), np.full((40, 40), 0.36, np.float32)
    tones = toned({"cam00": dim, "cam01": bright})
    assert tones["cam01"].max() == pytest.approx(1)
    assert tones["cam00"].max() == pytest.approx(0.5)


def test_a_network_that_has_learnt_nothing_is_refused(rig, images):
    torch.manual_seed(0)
    with pytest.raises(GeometryError, match="found no overlap of cam00, cam02, cam11, cam20, cam22 with"):
        dust3r_with(Dust3r(SMALL), rig, images)


def test_a_checkpoint_is_asked_for_and_used(tmp_path, rig, images):
    with pytest.raises(BadRunError, match=r"expected --dust3r-checkpoint FILE; none is shipped.*CC BY-NC-SA"):
        dust3r(rig, images, None)
    with pytest.raises(BadRunError, match="found no such file"):
        dust3r(rig, images, tmp_path / "absent.pth")
    model = (
        "AsymmetricCroCo3DStereo(pos_embed='RoPE100', head_type='linear', enc_embed_dim=16, enc_depth=1, "
        "enc_num_heads=2, dec_embed_dim=16, dec_depth=1, dec_num_heads=2)"
    )
    torch.manual_seed(0)
    content = {"args": argparse.Namespace(model=model), "model": Dust3r(SMALL).state_dict()}
    torch.save(content, tmp_path / "net.pth")
    with pytest.raises(GeometryError, match="found no overlap"):
        dust3r(rig, images, tmp_path / "net.pth")


def test_what_does_not_fit_is_refused(rig, images):
    odd = replace(rig, cameras=tuple(c.scaled(100, 62) if c.id == "cam11" else c for c in rig.cameras))
    changed = dict(images) | {"cam11": images["cam11"][:62, :100]}
    with pytest.raises(BadRunError, match="cam11: found the size 100x62, expected 200x125 as of cam00"):
        dust3r_with(Dust3r(SMALL), odd, changed)
