"""Splat files read back by others' readers or the published layout, and rendered: the picture must be the run's own."""

import gzip
import json
import struct
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices
from reconstruction.export.splats import splats_at
from reconstruction.rendering.render import render
from rigs.transform import Transform

SH_0 = 0.5 / np.sqrt(np.pi)
GLTF = "KHR_gaussian_splatting:"
RIG_FROM_UP = Transform(np.diag([1.0, -1.0, -1.0]), np.zeros(3))  # y up, z backward, as OpenGL and glTF
INSTANT_S = 0.005


def decoded_ply(path):
    """Means, quaternions, linear scales, opacities, display grey, by trimesh's reader and 3DGS's activations."""
    v = trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"]
    columns = lambda *names: np.stack([v[n] for n in names], -1)  # noqa: E731
    assert list(v.dtype.names) == [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
        *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
    colours = 0.5 + SH_0 * columns("f_dc_0", "f_dc_1", "f_dc_2")
    assert np.ptp(colours, axis=1).max(initial=0) == 0
    return (
        columns("x", "y", "z"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
        np.exp(columns("scale_0", "scale_1", "scale_2")),
        1 / (1 + np.exp(-v["opacity"])),
        colours[:, 0],
    )


def decoded_splat(path):
    raw = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, 32)
    numbers = np.ascontiguousarray(raw[:, :24]).view("<f4")
    quats = (raw[:, 28:].astype(float) - 128) / 128
    return numbers[:, :3], quats, numbers[:, 3:], raw[:, 27] / 255, raw[:, 24] / 255


def decoded_spz(path):
    """By the README of nianticlabs/spz; quaternions by its smallest-three rule."""
    data = gzip.decompress(path.read_bytes())
    magic, version, n, degree, bits, flags, reserved = struct.unpack_from("<IIIBBBB", data)
    assert (magic, version, degree, flags, reserved) == (0x5053474E, 3, 0, 1, 0)
    assert len(data) == 16 + n * (9 + 1 + 3 + 3 + 4)
    at, parts = 16, []
    for width in (9, 1, 3, 3, 4):
        parts.append(np.frombuffer(data, np.uint8, n * width, at).reshape(n, width).astype(np.int64))
        at += n * width
    places, alphas, colours, scales, packed = parts
    triples = places.reshape(n, 3, 3) @ [1, 256, 65536]
    means = np.where(triples >= 2**23, triples - 2**24, triples) / 2**bits
    quats = np.stack([smallest_three(word) for word in packed @ [1, 256, 65536, 2**24]]) if n else np.zeros((0, 4))
    grey = 0.5 + SH_0 * (colours[:, 0] / 255 - 0.5) / 0.15
    return means, quats, np.exp(scales / 16 - 10), alphas[:, 0] / 255, grey


def smallest_three(word):
    """(w, x, y, z) of one packed quaternion."""
    largest, xyzw = int(word >> 30), np.zeros(4)
    for axis in reversed([axis for axis in range(4) if axis != largest]):
        xyzw[axis] = (-1 if word & 512 else 1) * (word & 511) / 511 * np.sqrt(0.5)
        word >>= 10
    xyzw[largest] = np.sqrt(1 - (xyzw**2).sum())
    return np.roll(xyzw, 1)


def gltf_of(path):
    """The JSON and binary chunks of a GLB."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    at, chunks = 12, {}
    while at < length:
        size, kind = struct.unpack_from("<I4s", data, at)
        assert size % 4 == 0
        chunks[kind] = data[at + 8 : at + 8 + size]
        at += 8 + size
    return json.loads(chunks[b"JSON"]), chunks.get(b"BIN\0", b"")


def decoded_glb(path):
    """The extension's attributes."""
    document, data = gltf_of(path)
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"] == {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
    }
    found = {}
    for name, index in primitive["attributes"].items():
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        kind = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        array = np.frombuffer(data, kind, accessor["count"] * width, view["byteOffset"])
        found[name] = array.reshape(-1, width)
    assert np.allclose(np.linalg.norm(found[GLTF + "ROTATION"], axis=1), 1, atol=1e-6)
    grey = 0.5 + SH_0 * found[GLTF + "SH_DEGREE_0_COEF_0"][:, 0]
    quats = np.roll(found[GLTF + "ROTATION"], 1, axis=1)
    return found["POSITION"], quats, found[GLTF + "SCALE"], found[GLTF + "OPACITY"][:, 0], grey


def picture(decoded, camera, light):
    """Render decoded Gaussians for `camera`; `light` is their linear light over white."""
    means, quats, scales, opacities, _ = decoded
    arrays = (means, quats, np.log(scales), opacities, light[:, None])
    with torch.no_grad():
        return render(tuple(torch.from_numpy(np.array(a, np.float32)) for a in arrays), camera).intensity[..., 0]


# format: reader, whether its axes are y up, tolerance of a pixel in parts of white; worst 4e-7, .0093, .0127, 4e-7
READERS = {
    "ply": (decoded_ply, False, 2e-6),
    "splat": (decoded_splat, False, 0.012),
    "spz": (decoded_spz, True, 0.016),
    "glb": (decoded_glb, True, 2e-6),
}


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("kind", ["linear", "bases"])
def test_what_is_read_back_shows_the_runs_own_picture(name, kind, scene_with, tmp_path):
    scene, (read, upright, tolerance) = scene_with(kind), READERS[name]
    path = tmp_path / f"scene.{name}"
    export_scene(scene, name, path, Choices(at_s=INSTANT_S))
    decoded = read(path)
    light = np.clip(decoded[4], 0, None) ** 2.2
    for camera in scene.rig.cameras:
        own = scene.cloud.look(camera, INSTANT_S).intensity / scene.white
        assert own.max() > 0.3
        seen_from = replace(camera, cam_from_rig=camera.cam_from_rig @ RIG_FROM_UP) if upright else camera
        assert np.abs(picture(decoded, seen_from, light).numpy() - own).max() < tolerance
        unturned = (decoded[0], np.tile([1.0, 0, 0, 0], (len(light), 1)), *decoded[2:])
        assert np.abs(picture(unturned, seen_from, light).numpy() - own).max() > 5 * tolerance


@pytest.mark.parametrize("name", READERS)
def test_values_come_back_within_the_formats_precision(name, scene_with, tmp_path):
    scene, (read, upright, _) = scene_with("cubic"), READERS[name]
    path = tmp_path / f"scene.{name}"
    export_scene(scene, name, path, Choices(at_s=INSTANT_S))
    means, _, scales, opacities, _ = read(path)
    expected = splats_at(scene, INSTANT_S)
    if name == "splat":
        importance = expected.opacities * expected.scales.prod(axis=1)
        expected = expected.select(np.argsort(-importance))
    flip = [1, -1, -1] if upright else [1, 1, 1]
    assert np.abs(means * flip - expected.means).max() < 1e-6
    assert np.abs(np.log(scales) - np.log(expected.scales)).max() < (1 / 32 + 1e-5 if name == "spz" else 1e-5)
    assert np.abs(opacities - expected.opacities).max() < (1e-5 if name in ("ply", "glb") else 0.5 / 255 + 1e-6)


def test_trimesh_reads_the_glb_as_points(scene_with, tmp_path):
    scene = scene_with()
    export_scene(scene, "glb", tmp_path / "scene.glb", Choices(at_s=INSTANT_S))
    (points,) = trimesh.load(tmp_path / "scene.glb").geometry.values()
    splats = splats_at(scene, INSTANT_S)
    assert np.allclose(points.vertices, splats.means * [1, -1, -1], atol=1e-6)
    assert np.allclose(points.colors[:, 3], 255 * splats.opacities, atol=0.51)
    assert np.allclose(points.colors[:, 0], 255 * splats.intensities.clip(0, 1), atol=0.51)
    document, _ = gltf_of(tmp_path / "scene.glb")
    assert document["accessors"][0]["min"] == pytest.approx(points.vertices.min(axis=0).tolist())
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]


def test_the_most_important_splat_comes_first(scene_with, tmp_path):
    export_scene(scene_with(), "splat", tmp_path / "scene.splat", Choices())
    _, _, scales, opacities, _ = decoded_splat(tmp_path / "scene.splat")
    importance = scales.astype(float).prod(axis=1) * opacities
    assert (np.diff(importance) <= 0.01 * importance[0]).all()
    assert importance[0] > 2 * importance[-1]


def test_what_is_too_faint_to_be_drawn_is_left_out(scene_with):
    scene = scene_with("linear", still=3, moving=0)
    scene.cloud.still.opacity_logits[:] = torch.tensor([0.0, -6.0, 2.0])
    assert len(splats_at(scene, INSTANT_S)) == 2
    scene.cloud.still.opacity_logits[:] = torch.tensor([200.0, -200.0, 2.0])
    assert splats_at(scene, INSTANT_S).opacities[0] == 1


def test_an_opaque_gaussian_has_a_finite_logit(one_scene, tmp_path):
    one_scene.cloud.still.opacity_logits[:] = 200
    export_scene(one_scene, "ply", tmp_path / "scene.ply", Choices())
    logit = trimesh.load(tmp_path / "scene.ply").metadata["_ply_raw"]["vertex"]["data"]["opacity"]
    assert 10 < logit[0] < 20


@pytest.mark.parametrize("name", ["splat", "spz"])
def test_no_gaussians_make_an_empty_file(name, empty_scene, tmp_path):
    export_scene(empty_scene, name, tmp_path / "file", Choices())
    assert len(READERS[name][0](tmp_path / "file")[0]) == 0


def test_no_gaussians_make_a_ply_without_rows_and_a_glb_without_a_mesh(empty_scene, tmp_path):
    export_scene(empty_scene, "ply", tmp_path / "scene.ply", Choices())
    assert b"element vertex 0\n" in (tmp_path / "scene.ply").read_bytes()
    assert (tmp_path / "scene.ply").read_bytes().endswith(b"end_header\n")
    export_scene(empty_scene, "glb", tmp_path / "scene.glb", Choices())
    document, data = gltf_of(tmp_path / "scene.glb")
    assert "meshes" not in document
    assert "accessors" not in document
    assert data == b""


def test_a_sequence_has_the_gaussians_of_each_instant(scene_with, tmp_path):
    scene = scene_with("cubic")
    export_scene(scene, "ply-sequence", tmp_path / "clip", Choices(frames=4))
    manifest = json.loads((tmp_path / "clip" / "manifest.json").read_text())
    assert [frame["file"] for frame in manifest["frames"]] == [f"{i:06d}.ply" for i in range(4)]
    instants = [frame["instant_s"] for frame in manifest["frames"]]
    assert instants == pytest.approx([0.00325, 0.00575, 0.00825, 0.01075])
    for frame in manifest["frames"]:
        means = decoded_ply(tmp_path / "clip" / frame["file"])[0]
        assert np.array_equal(means, splats_at(scene, frame["instant_s"]).means)
