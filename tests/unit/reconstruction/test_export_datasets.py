"""Datasets, videos and depth maps read back: COLMAP's by pycolmap, nerfstudio's by the rig's reader, videos by av."""

import json
from dataclasses import replace
from types import SimpleNamespace

import av
import cv2
import numpy as np
import pycolmap
import pytest

from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.export.splats import splats_at
from reconstruction.report import pictures
from reconstruction.report.display import grey
from reconstruction.report.pictures import depth_colours
from rigs.exchange.colmap import load_model
from rigs.exchange.nerfstudio import load_frames

INSTANT_S = 0.005


def frames_of(path):
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format="gray") for frame in container.decode(video=0)]


def test_pycolmap_reads_the_model_and_projects_its_points_where_the_pictures_show_them(one_scene, tmp_path):
    export_scene(one_scene, "colmap", tmp_path / "model", Choices(at_s=INSTANT_S))
    model = pycolmap.Reconstruction(str(tmp_path / "model" / "sparse" / "0"))
    (point,) = model.points3D.values()
    assert np.allclose(point.xyz, [0.2, -0.1, 2.2], atol=1e-6)
    assert point.color.tolist() == [255, 255, 255]
    assert {image.name for image in model.images.values()} == {"cam00.png", "cam01.png", "cam02.png"}
    for image in model.images.values():
        picture = cv2.imread(str(tmp_path / "model" / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        assert picture.shape == (41, 64)
        weights = (picture / 255.0) ** 2.2
        rows, columns = np.mgrid[:41, :64] + 0.5
        seen = np.array([(weights * columns).sum(), (weights * rows).sum()]) / weights.sum()
        assert np.abs(seen - image.project_point(point.xyz)).max() < 0.05


def test_the_colmap_model_has_the_rigs_cameras_without_a_lens_where_there_is_none(scene_with, tmp_path):
    scene = scene_with("linear")
    export_scene(scene, "colmap", tmp_path / "model", Choices())
    assert "PINHOLE" in (tmp_path / "model" / "sparse" / "0" / "cameras.txt").read_text()
    for own, camera in zip(scene.rig.cameras, load_model(tmp_path / "model" / "sparse" / "0"), strict=True):
        assert own.id == camera.id
        assert np.allclose(own.K, camera.K)
        assert np.allclose(own.cam_from_rig.matrix, camera.cam_from_rig.matrix, atol=1e-12)
    model = pycolmap.Reconstruction(str(tmp_path / "model" / "sparse" / "0"))
    assert len(model.points3D) == len(splats_at(scene, scene.cloud.clip.middle_s))


def with_targets(scene):
    """The scene with targets for two cameras: plane k is k / 1000 everywhere but in a corner."""

    def at(plane):
        image = np.full((41, 64), plane / 1000, np.float32)
        image[0, 0] = scene.white
        return image

    return replace(scene, targets=lambda: {view: SimpleNamespace(at=at) for view in ("cam00", "cam02")})


def test_nerfstudio_frames_have_cameras_times_and_the_target_images(scene_with, tmp_path):
    scene = with_targets(scene_with("linear"))
    export_scene(scene, "nerfstudio", tmp_path / "set", Choices(frames=5))
    frames = load_frames(tmp_path / "set" / "transforms.json")
    document = json.loads((tmp_path / "set" / "transforms.json").read_text())
    assert [f.camera.id for f in frames] == ["cam00"] * 5 + ["cam02"] * 5
    planes = [60, 100, 140, 180, 220]
    assert [f.instant_s for f in frames[:5]] == pytest.approx([(plane + 0.5) / 20000 for plane in planes])
    for frame, table, plane in zip(frames, document["frames"], planes * 2, strict=True):
        own = scene.rig.camera(frame.camera.id)
        assert np.allclose(frame.camera.cam_from_rig.matrix, own.cam_from_rig.matrix, atol=1e-12)
        picture = cv2.imread(str(tmp_path / "set" / table["file_path"]), cv2.IMREAD_GRAYSCALE)
        assert picture[0, 0] == 255
        assert picture[5, 5] == round(255 * (plane / 1000 / scene.white) ** (1 / 2.2))
    assert (tmp_path / "set" / document["ply_file_path"]).read_bytes().startswith(b"ply\n")


def test_more_frames_than_planes_are_as_many_as_there_are_planes(one_scene, tmp_path):
    scene = with_targets(one_scene)
    scene.cloud.clip = replace(scene.cloud.clip, first_s=0.0, last_s=4 / 20000)
    export_scene(scene, "nerfstudio", tmp_path / "set", Choices(frames=30))
    assert json.loads((tmp_path / "set" / "manifest.json").read_text())["planes"] == [0, 1, 2, 3]


def test_a_video_from_a_camera_shows_what_it_sees(scene_with, tmp_path):
    scene = scene_with("linear")
    export_scene(scene, "video", tmp_path / "clip.mp4", Choices(frames=6, camera="cam02"))
    shown = frames_of(tmp_path / "clip.mp4")
    assert [picture.shape for picture in shown] == [(40, 64)] * 6
    for picture, instant_s in zip(shown, scene.instants_s(Choices(frames=6)), strict=True):
        own = grey(scene.cloud.look(scene.rig.camera("cam02"), instant_s).intensity, scene.white)[:40]
        assert np.abs(picture.astype(float) - own).mean() < 3.5  # of 255, H.264's loss; worst measured 2.4
    other = grey(scene.cloud.look(scene.rig.camera("cam00"), 0.00283).intensity, scene.white)[:40]
    assert np.abs(shown[0].astype(float) - other).mean() > 7
    assert np.abs(shown[0].astype(float) - shown[-1]).mean() > 7


def test_a_video_without_a_camera_is_the_orbit_with_its_depth(scene_with, tmp_path):
    export_scene(scene_with("linear"), "video", tmp_path / "orbit.mp4", Choices(frames=8))
    shown = frames_of(tmp_path / "orbit.mp4")
    assert [picture.shape for picture in shown] == [(40, 128)] * 8
    assert np.abs(shown[0].astype(float) - shown[4]).mean() > 3


def test_large_pictures_of_an_orbit_are_halved(scene_with, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "MOST_PX", 64 * 41 - 1)
    export_scene(scene_with("linear"), "video", tmp_path / "orbit.mp4", Choices(frames=2))
    assert [picture.shape for picture in frames_of(tmp_path / "orbit.mp4")] == [(20, 64)] * 2


def test_depth_maps_are_what_the_camera_sees_with_colours_on_one_scale(scene_with, tmp_path):
    scene = scene_with("linear")
    export_scene(scene, "depth", tmp_path / "depth", Choices(frames=3))
    manifest = json.loads((tmp_path / "depth" / "manifest.json").read_text())
    assert manifest["camera"] == "cam01"  # the held-out one
    for i, frame in enumerate(manifest["frames"]):
        depth = np.load(tmp_path / "depth" / frame["file"])
        own = scene.cloud.look(scene.rig.camera("cam01"), frame["instant_s"]).depth
        assert depth.dtype == np.float32
        assert np.array_equal(depth, own, equal_nan=True)
        assert np.isnan(depth).any()
        assert 1.3 < np.nanmin(depth) < np.nanmax(depth) < 2.7
        colours = cv2.imread(str(tmp_path / "depth" / f"{i:06d}.png"))
        assert np.array_equal(colours, depth_colours(own, *manifest["colours_m"]))


def test_an_empty_scene_is_dark_and_has_no_depth(empty_scene, tmp_path):
    for name in ("colmap", "depth", "video"):
        export_scene(empty_scene, name, tmp_path / name, Choices() if name == "colmap" else Choices(frames=2))
    assert np.isnan(np.load(tmp_path / "depth" / "000000.npy")).all()
    assert not pycolmap.Reconstruction(str(tmp_path / "colmap" / "sparse" / "0")).points3D
    assert max(picture[:, :60].max() for picture in frames_of(tmp_path / "video")) < 8
