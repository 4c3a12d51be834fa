"""Evaluates the browser's scene by its contract and renders it: the picture must be the run's own."""

import json
import math

import numpy as np
import pytest
import torch

from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.export.viewer import viewer_of
from reconstruction.export.viewer_arrays import KEYFRAMES
from reconstruction.rendering.render import render
from rigs.camera import Camera
from rigs.transform import Transform

BASE = {"means": (3,), "quats_wxyz": (4,), "scales": (3,), "opacities": (), "intensities": ()}
SHAPES = {
    "static": {},
    "linear": {"velocities": (3,), "instants": (), "durations": ()},
    "cubic": {"velocities": (3,), "accelerations": (3,), "jerks": (3,), "instants": (), "durations": ()},
    "bases": {"key_means": (3,), "key_quats": (4,), "key_opacities": ()},
    "4dgs": {"key_means": (3,), "key_quats": (4,), "key_opacities": (), "key_scales": (3,), "key_intensities": ()},
    "4dgs-small": {"key_means": (3,), "key_quats": (4,), "key_opacities": (), "key_scales": (3,)},
    "stg": {"key_means": (3,), "key_quats": (4,), "key_opacities": ()},
    "d3dgs": {"key_means": (3,), "key_quats": (4,), "key_opacities": ()},
}


def arrays_of(document, data):
    """The arrays by name; every byte belongs to one."""
    found, used = {}, 0
    for name, place in document["arrays"].items():
        assert place["dtype"] == "float32"
        assert place["offset"] % 4 == 0
        count = math.prod(place["shape"])
        found[name] = np.frombuffer(data, "<f4", count, place["offset"]).reshape(place["shape"]).copy()
        used += 4 * count
    assert used == len(data)
    return found


def played(document, arrays, u):
    """Means, quaternions, scales, opacities at u, by the words of the contract."""
    still, now = document["still"], {name: arrays[name].copy() for name in BASE}
    if document["motion"] == "polynomial":
        s = (u - arrays["instants"])[:, None]
        now["means"][still:] += arrays["velocities"] * s
        if document["degree"] == 3:
            now["means"][still:] += arrays["accelerations"] * s**2 / 2 + arrays["jerks"] * s**3 / 6
        now["opacities"][still:] *= np.exp(-((s[:, 0] / arrays["durations"]) ** 2) / 2)
    if document["motion"] == "keyframes":
        k = round(u * (document["keyframes"] - 1))
        now["means"][still:], now["quats_wxyz"][still:] = arrays["key_means"][k], arrays["key_quats"][k]
        now["opacities"][still:] = arrays["key_opacities"][k]
        if "key_scales" in arrays:
            now["scales"][still:] = arrays["key_scales"][k]
        if "key_intensities" in arrays:
            now["intensities"][still:] = arrays["key_intensities"][k]
    return now


def camera_of(table):
    lens = (table[name] for name in ("width", "height", "fx", "fy", "cx", "cy"))
    pose = np.reshape(table["cam_from_rig"], (4, 4))
    return Camera(table["id"], *lens, Transform(pose[:3, :3], pose[:3, 3]))


@pytest.mark.parametrize("kind", SHAPES)
def test_every_motion_model_plays_as_the_run_renders_it(kind, scene_with):
    scene = scene_with("linear", moving=0) if kind == "static" else scene_with(kind)
    document, data = viewer_of(scene)
    arrays = arrays_of(document, data)
    clip = scene.cloud.clip
    for u in (0.0, 8 / 23, 1.0):
        now = played(document, arrays, u)
        tensors = (
            now["means"],
            now["quats_wxyz"],
            np.log(now["scales"]),
            now["opacities"],
            now["intensities"][:, None],
        )
        with torch.no_grad():
            options = {"dilation_px2": document["dilation_px2"]}
            cameras = [camera_of(table) for table in document["cameras"]]
            shown = [render(tuple(map(torch.from_numpy, tensors)), camera, **options).intensity for camera in cameras]
        for camera, picture in zip(scene.rig.cameras, shown, strict=True):
            own = scene.cloud.look(camera, clip.first_s + u * (clip.last_s - clip.first_s)).intensity / scene.white
            assert own.max() > 0.2
            assert np.abs(picture[..., 0].numpy() - own).max() < 1e-5  # worst measured 2e-6


@pytest.mark.parametrize("kind", SHAPES)
def test_the_document_is_as_agreed(kind, scene_with):
    scene = scene_with("linear", moving=0) if kind == "static" else scene_with(kind)
    document, data = viewer_of(scene)
    arrays = arrays_of(document, data)
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    n, m = document["count"], document["moving"]
    assert n == document["still"] + m == len(arrays["means"])
    assert 0 < document["still"] <= len(scene.cloud.still)
    assert document["version"] == 1
    assert document["clip_s"] == [0.002, 0.012]
    motions = {"static": ("static", 0, 0), "linear": ("polynomial", 1, 0), "cubic": ("polynomial", 3, 0)}
    found = (document["motion"], document["degree"], document["keyframes"])
    assert found == motions.get(kind, ("keyframes", 0, KEYFRAMES))
    expected = {name: (n, *rest) for name, rest in BASE.items()}
    keys = (document["keyframes"],) if document["keyframes"] else ()
    expected |= {name: (*keys, m, *rest) for name, rest in SHAPES[kind].items()}
    assert {name: array.shape for name, array in arrays.items()} == expected
    assert np.allclose(np.linalg.norm(arrays["quats_wxyz"], axis=-1), 1, atol=1e-6)
    assert [(c["id"], c["held_out"]) for c in document["cameras"]] == [
        *[("cam00", False), ("cam01", True), ("cam02", False)]
    ]
    near, far = document["depth_m"]
    assert 1.3 < near < far < 2.7
    assert np.linalg.norm(np.subtract(document["centre"], [0, 0, 2])) < 0.4


def test_neighbouring_keys_can_be_mixed(scene_with):
    """A Gaussian's quaternion may change its sign on the way; mixed half-way, the wrong one would be no turn at all."""
    scene = scene_with("bases")
    at = scene.cloud.motion.at

    def flipping(moving, u):
        now = at(moving, u)
        return now._replace(quats_wxyz=now.quats_wxyz * (-1 if u > 0.5 else 1))

    scene.cloud.motion.at = flipping
    quats = arrays_of(*viewer_of(scene))["key_quats"]
    assert (np.sum(quats[1:] * quats[:-1], axis=-1) > 0.9).all()


def test_what_is_never_seen_is_left_out_and_what_is_seen_once_is_kept(scene_with):
    scene = scene_with("linear", still=2, moving=3)
    scene.cloud.still.opacity_logits[:] = torch.tensor([2.0, -9.0])
    scene.cloud.moving.opacity_logits[:] = torch.tensor([2.0, -9.0, 2.0])
    scene.cloud.motion.instants[:] = torch.tensor([0.9, 0.5, 4.0])  # the third long after the clip
    scene.cloud.motion.log_durations[:] = math.log(0.01)
    document, data = viewer_of(scene)
    assert (document["still"], document["moving"]) == (1, 1)
    arrays = arrays_of(document, data)
    assert arrays["instants"].tolist() == pytest.approx([0.9])
    assert arrays["durations"].tolist() == pytest.approx([0.01])


def test_durations_beyond_what_is_rendered_are_held(scene_with):
    scene = scene_with("linear", moving=2)
    scene.cloud.motion.instants[:] = 0.5
    scene.cloud.motion.log_durations[:] = torch.tensor([-100.0, 100.0])
    assert arrays_of(*viewer_of(scene))["durations"].tolist() == pytest.approx([1e-3, 1e3])


@pytest.mark.parametrize("kind", ["bases", "4dgs", "4dgs-small", "stg", "d3dgs"])
def test_movers_that_are_never_seen_leave_a_static_scene(kind, scene_with):
    scene = scene_with(kind)
    scene.cloud.moving.opacity_logits[:] = -20
    document, data = viewer_of(scene)
    assert (document["motion"], document["moving"], document["keyframes"]) == ("static", 0, 0)
    assert set(arrays_of(document, data)) == set(BASE)


def test_an_empty_scene_has_empty_arrays(empty_scene):
    document, data = viewer_of(empty_scene)
    assert (document["count"], data) == (0, b"")
    assert all(math.isfinite(number) for number in (*document["centre"], *document["depth_m"]))


def test_one_gaussian_is_what_the_viewer_looks_at(one_scene, tmp_path):
    export_scene(one_scene, "viewer", tmp_path / "viewer", Choices())
    assert {f.name for f in (tmp_path / "viewer").iterdir()} == {"viewer.json", "viewer.bin", "manifest.json"}
    document = json.loads((tmp_path / "viewer" / "viewer.json").read_text())
    arrays = arrays_of(document, (tmp_path / "viewer" / "viewer.bin").read_bytes())
    assert arrays["intensities"].tolist() == pytest.approx([1])
    assert document["centre"] == pytest.approx([0.2, -0.1, 2.2], abs=0.03)
