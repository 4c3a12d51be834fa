"""The native ray caster against closed forms, against its NumPy twin, and against itself without any shortcut."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from references.raycast import trace_reference

from acquisition.errors import AcquisitionError
from acquisition.native import code_path, code_paths
from acquisition.scenes.bodies import KINDS, Body, Finish, Shape, still
from acquisition.scenes.light import EVEN, Uneven
from acquisition.scenes.motion import Motion
from acquisition.scenes.raycast import Raycaster, SceneArrays
from acquisition.scenes.scene import Scene
from rigs.camera import Camera
from rigs.transform import Transform

GREY = np.full((1, 4, 4), 0.5, dtype=np.float32)
PLAIN = Finish(0, 0.1, (0.0, 1.0))  # albedo 0.5 with GREY


def camera(width=40, height=30, focal=35.0, pose=None) -> Camera:
    pose = pose or Transform.identity()
    return Camera("cam11", width, height, focal, focal, width / 2, height / 2, pose)


def scene(*bodies: Body, textures=GREY, to_sun=(0.0, 0.0, -1.0), **kind) -> Scene:
    return Scene("test", 0, bodies, textures, (0, 0, 2), to_sun, **kind)


def one(shape: Shape, z: float = 2.0, **kind) -> Scene:
    return scene(still("thing", (0, 0, z), shape), **kind)


def random_rotation(rng) -> np.ndarray:
    return Transform.from_quat_wxyz(rng.standard_normal(4), np.zeros(3)).rotation


def random_geometry(rng, count: int) -> tuple[SceneArrays, np.ndarray, np.ndarray]:
    """Shapes of every kind strewn before, around and behind the camera; about half of them move."""
    rows = np.zeros((count, 10))
    rows[:, 0] = rng.integers(0, 4, count)
    rows[:, 1:4] = rng.uniform(0.02, 0.6, (count, 3))
    rows[:, 4] = rng.integers(0, 2, count)
    rows[:, 5:8] = rng.uniform(1, 50, (count, 3))
    rows[:, 8:] = np.sort(rng.random((count, 2)))
    sun = rng.standard_normal(3)
    textures = rng.random((2, 16, 16), dtype=np.float32)
    ids = np.arange(1, count + 1, dtype=np.int8)
    geometry = SceneArrays(
        rows,
        rng.random(count) < 0.5,
        ids,
        textures,
        sun / np.linalg.norm(sun),
        0.6,
        0.3,
        0.1,
        uneven=Uneven(tuple(rng.uniform(-0.3, 0.3, 3)), 0.8, 0.1) if rng.random() < 0.5 else EVEN,
        mipmapped=rng.random() < 0.5,
    )
    return geometry, np.stack([random_rotation(rng) for _ in range(count)]), rng.uniform(-1.5, 2.5, (count, 3))


def trace(geometry, view, rotations, positions, samples=2, threads=1):
    caster = Raycaster(geometry, view, (rotations, positions), samples=samples, threads=threads)
    return caster.frames(rotations[None], positions[None], np.ones(1))


def same(a, b) -> bool:
    return (
        np.array_equal(a.intensity, b.intensity)
        and np.array_equal(a.depth, b.depth, equal_nan=True)
        and np.array_equal(a.ids, b.ids)
    )


@given(seed=st.integers(0, 10_000), count=st.integers(1, 24), focal=st.sampled_from([3.0, 20.0, 300.0]))
@settings(max_examples=40)
def test_native_agrees_with_the_twin(seed, count, focal):
    rng = np.random.default_rng(seed)
    geometry, rotations, positions = random_geometry(rng, count)
    view = camera(17, 11, focal, Transform(random_rotation(rng), rng.uniform(-0.5, 0.5, 3)))
    gain = rng.choice([0.0, 0.3, 1.0])
    caster = Raycaster(geometry, view, (rotations, positions), samples=2, threads=1)
    ours = caster.frames(rotations[None], positions[None], np.array([gain]))
    twin = trace_reference(geometry, view, rotations, positions, samples=2, gain=gain)
    # Rays that graze an edge may fall on either side of it: rounding differs by matrix products.
    off = np.abs(ours.intensity - twin.intensity) > 1e-5
    assert off.mean() <= 2 / off.size
    assert (ours.ids != twin.ids).mean() <= 1 / off.size
    matched = ours.ids == twin.ids
    np.testing.assert_allclose(ours.depth[matched], twin.depth[matched], rtol=1e-5)


@given(seed=st.integers(0, 10_000), count=st.integers(2, 24), focal=st.sampled_from([3.0, 20.0, 300.0]))
@settings(max_examples=40)
def test_retracing_only_what_moves_changes_no_bit(seed, count, focal):
    rng = np.random.default_rng(seed)
    geometry, rotations, positions = random_geometry(rng, count)
    view = camera(33, 21, focal, Transform(random_rotation(rng), rng.uniform(-0.5, 0.5, 3)))
    everything = replace(geometry, moving=np.ones(count, dtype=bool))
    assert same(trace(geometry, view, rotations, positions), trace(everything, view, rotations, positions))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("focal", [5.0, 40.0, 150.0])
def test_retracing_reaches_the_rim_of_spheres_and_of_their_shadows(seed, focal):
    """Spheres fill their bounds, so a bound that is a little too tight loses pixels here."""
    rng = np.random.default_rng(seed)
    geometry, rotations, positions = random_geometry(rng, 40)
    geometry.shapes[:, 0] = 2
    geometry.shapes[:, 1] = rng.uniform(0.05, 0.25, 40)
    positions = rng.uniform((-0.8, -0.8, 1.0), (0.8, 0.8, 2.6), (40, 3))
    geometry = replace(geometry, sun=np.array([0.6, 0.0, -0.8]))
    view = camera(64, 48, focal)
    everything = replace(geometry, moving=np.ones(40, dtype=bool))
    ours = trace(geometry, view, rotations, positions)
    assert same(ours, trace(everything, view, rotations, positions))
    off = np.abs(ours.intensity - trace_reference(geometry, view, rotations, positions, 2).intensity) > 1e-5
    assert off.mean() <= 2 / off.size


@pytest.mark.parametrize("kind", ["rectangle", "box", "cylinder"])
@pytest.mark.parametrize("focal", [5.0, 40.0, 150.0])
def test_retracing_reaches_the_corners_of_rods_and_plates_and_of_their_shadows(kind, focal):
    """Boxes fill the boxes that bound them, and rods are far smaller than the spheres that do."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        geometry, rotations, positions = random_geometry(rng, 30)
        geometry.shapes[:, 0] = KINDS.index(kind)
        geometry.shapes[:, 1:4] = np.exp(rng.uniform(np.log(0.004), np.log(0.7), (30, 3)))
        positions = rng.uniform((-0.9, -0.9, 0.2), (0.9, 0.9, 2.6), (30, 3))
        geometry = replace(geometry, sun=np.array([0.6, 0.0, -0.8]), mipmapped=False)
        view = camera(64, 48, focal)
        ours = trace(geometry, view, rotations, positions)
        assert same(ours, trace(replace(geometry, moving=np.ones(30, dtype=bool)), view, rotations, positions))
        off = np.abs(ours.intensity - trace_reference(geometry, view, rotations, positions, 2).intensity) > 1e-5
        assert off.mean() <= 2 / off.size


@pytest.mark.parametrize("samples", [1, 2, 3, 5])
@pytest.mark.parametrize("width", [1, 7, 8, 9, 17])
def test_rays_that_fill_no_eight_are_those_of_the_twin(samples, width):
    geometry, rotations, positions = random_geometry(np.random.default_rng(7), 16)
    view = camera(width, 5, 6.0)
    ours = trace(geometry, view, rotations, positions, samples)
    twin = trace_reference(geometry, view, rotations, positions, samples)
    np.testing.assert_allclose(ours.intensity, twin.intensity, atol=1e-5)
    assert (ours.ids == twin.ids).all()


@pytest.mark.parametrize("seed", range(4))
def test_every_build_traces_the_same_bits(seed):
    geometry, rotations, positions = random_geometry(np.random.default_rng(seed), 24)
    frames = []
    for name in code_paths():
        with code_path(name):
            frames.append(trace(replace(geometry, mipmapped=True), camera(), rotations, positions))
    assert all(same(frames[0], other) for other in frames[1:])


def test_threads_change_no_bit():
    geometry, rotations, positions = random_geometry(np.random.default_rng(1), 20)
    frames = [trace(geometry, camera(), rotations, positions, threads=n) for n in (1, 2, 5)]
    assert same(frames[0], frames[1])
    assert same(frames[0], frames[2])


def test_a_wall_has_one_depth_and_lamberts_light():
    to_sun = (0.6, 0.0, -0.8)
    frames = one(Shape("rectangle", (9, 9), PLAIN), to_sun=to_sun).render(camera(), np.zeros(1), 2)
    assert (frames.depth == 2).all()
    np.testing.assert_allclose(frames.intensity, 0.6 * 0.5 * (0.3 + 0.7 * 0.8), rtol=1e-6)


def test_a_surface_that_faces_away_from_the_sun_has_ambient_light_only():
    frames = one(Shape("rectangle", (9, 9), PLAIN), to_sun=(0, 0, 1)).render(camera(), np.zeros(1), 2)
    np.testing.assert_allclose(frames.intensity, 0.6 * 0.5 * 0.3, rtol=1e-6)


def test_a_sphere_has_the_depth_and_the_outline_of_its_formula():
    view, radius, z = camera(400, 400, 400.0), 0.5, 3.0
    frames = one(Shape("sphere", (radius,), PLAIN), z).render(view, np.zeros(1), 1)
    x, y = np.meshgrid(*(np.arange(400) + 0.5 - 200,) * 2)
    squared = (x**2 + y**2) / 400**2
    seen = squared <= radius**2 / (z**2 - radius**2)
    disc = np.where(seen, z**2 - (1 + squared) * (z**2 - radius**2), 0)
    np.testing.assert_array_equal(frames.ids[0] == 1, seen)
    np.testing.assert_allclose(frames.depth[0][seen], ((z - np.sqrt(disc)) / (1 + squared))[seen], rtol=1e-6)
    assert np.isnan(frames.depth[0][~seen]).all()


def still_depth(caster: Raycaster) -> np.ndarray:
    """The depth of what stands still on each pixel's centre ray, in double precision [H, W]; NaN: nothing."""
    middle = caster._still_arrays[4]
    return np.where(np.isfinite(middle), middle, np.nan)


def test_depth_of_a_plane_and_a_sphere_is_exact_in_double_precision():
    view, radius, z = camera(200, 150, 180.0), 0.5, 3.0
    x, y = np.meshgrid((np.arange(200) + 0.5 - 100) / 180, (np.arange(150) + 0.5 - 75) / 180)
    turned = Transform.from_quat_wxyz((0.9, 0.2, -0.3, 0.1), (0.1, -0.2, 2.5))
    plane = scene(Body("plane", (Shape("rectangle", (9, 9), PLAIN),), Motion(turned)))
    normal = turned.rotation[:, 2]
    expected = normal @ turned.translation / (normal[0] * x + normal[1] * y + normal[2])
    np.testing.assert_allclose(still_depth(plane.raycaster(view, 1)), expected, rtol=1e-12)
    found = still_depth(one(Shape("sphere", (radius,), PLAIN), z).raycaster(view, 1))
    squared = x**2 + y**2
    disc = z**2 - (1 + squared) * (z**2 - radius**2)
    np.testing.assert_array_equal(np.isfinite(found), disc >= 0)
    seen = disc > 0
    np.testing.assert_allclose(found[seen], ((z - np.sqrt(disc[seen])) / (1 + squared[seen])), rtol=1e-9)


def test_textures_finer_than_the_rays_are_averaged_and_do_not_alias():
    checks = (np.indices((64, 64)).sum(axis=0) % 2).astype(np.float32)[None]  # black and white texel by texel
    for texel_m in (0.001, 0.0033):
        wall = Shape("rectangle", (9, 9), Finish(0, texel_m, (0.0, 1.0), (0.3, 0.2)))
        for mipmapped, spread in ((True, 0.0), (False, 0.02)):
            far = one(wall, textures=checks, ambient=1.0, mipmapped=mipmapped).render(camera(), np.zeros(1), 2)
            assert far.intensity.mean() == pytest.approx(0.3, abs=0.05)
            assert (far.intensity.std() > spread) == (not mipmapped)
        near = one(wall, 0.01, textures=checks, ambient=1.0, mipmapped=True).render(camera(), np.zeros(1), 2)
        assert near.intensity.std() > 0.05


def test_boxes_and_cylinders_meet_the_axis_at_their_front():
    about_x = Transform(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.zeros(3))
    view = camera(5, 5, 100.0)
    for shape, front in (
        (Shape("box", (0.3, 0.2, 0.4), PLAIN), 1.6),
        (Shape("cylinder", (0.3, 0.4), PLAIN), 1.6),
        (Shape("cylinder", (0.3, 0.4), PLAIN, about_x), 1.7),
    ):
        assert one(shape).render(view, np.zeros(1), 1).depth[0, 2, 2] == pytest.approx(front, rel=1e-6)


def test_the_shadow_lies_where_the_sun_throws_it():
    lid = still("lid", (0.0, 0.0, 1.5), Shape("rectangle", (0.1, 0.1), PLAIN))
    wall = still("wall", (0, 0, 2.0), Shape("rectangle", (9, 9), PLAIN))
    view = camera(400, 300, 350.0)
    light = scene(wall, lid, to_sun=(-0.5, 0.0, -1.0)).render(view, np.zeros(1), 1)
    on_wall = light.ids[0] == 1
    dark = light.intensity[0] < 0.6 * 0.5 * 0.31
    x, y = np.meshgrid((np.arange(400) + 0.5 - 200) / 350 * 2, (np.arange(300) + 0.5 - 150) / 350 * 2)
    thrown = (np.abs(x - 0.25) <= 0.1) & (np.abs(y) <= 0.1)  # 0.5 m behind the lid: 0.25 m aside
    np.testing.assert_array_equal(dark[on_wall], thrown[on_wall])
    assert thrown[on_wall].sum() > 500


def test_the_texture_is_bilinear_between_texel_corners():
    ramp = np.tile(np.arange(4, dtype=np.float32) / 4, (4, 1))[None]
    wall = Shape("rectangle", (9, 9), Finish(0, 0.5, (0.0, 1.0)))
    frames = one(wall, textures=ramp, ambient=1.0).render(camera(9, 3, 8.0), np.zeros(1), 1)
    x = (np.arange(9) + 0.5 - 4.5) / 8 * 2 / 0.5  # in texels
    np.testing.assert_allclose(
        frames.intensity[0, 1], 0.6 * np.interp(x % 4, range(5), [0, 0.25, 0.5, 0.75, 0]), atol=1e-6
    )


def test_motion_takes_a_sphere_across_the_picture():
    motion = Motion(Transform(np.eye(3), np.array([0.0, 0.0, 2.0])), velocity_m_s=(1.0, 0.0, 0.0))
    ball = scene(Body("ball", (Shape("sphere", (0.1,), PLAIN),), motion))
    ids = ball.render(camera(400, 50, 350.0), np.array([-0.5, 0.0, 0.5]), 1).ids
    columns = [np.nonzero(frame.any(axis=0))[0].mean() + 0.5 for frame in ids]
    np.testing.assert_allclose(columns, [200 - 87.5, 200, 200 + 87.5], atol=0.51)


def test_nothing_in_view_is_background_without_depth():
    frames = one(Shape("sphere", (0.5,), PLAIN), -2.0).render(camera(), np.zeros(1), 4)
    assert np.isnan(frames.depth).all()
    assert not frames.ids.any()
    assert (frames.intensity == np.float32(0.02)).all()


def test_one_pixel_and_no_instants():
    thing = one(Shape("sphere", (0.5,), PLAIN))
    assert thing.render(camera(1, 1), np.zeros(1), 4).depth.item() == pytest.approx(1.5)
    assert thing.render(camera(7, 5), np.zeros(0), 2).intensity.shape == (0, 5, 7)


def test_more_samples_converge():
    geometry, rotations, positions = random_geometry(np.random.default_rng(5), 20)
    fine, rough, rougher = (trace(geometry, camera(), rotations, positions, n).intensity for n in (16, 4, 1))
    assert np.abs(rough - fine).mean() < 0.5 * np.abs(rougher - fine).mean()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"shapes": np.zeros((65, 10))}, "65 shapes"),
        ({"textures": np.zeros((1, 6, 6), np.float32)}, "power of two"),
        ({"textures": np.zeros((0, 8, 8), np.float32)}, "texture"),
    ],
)
def test_unusable_geometry_is_refused(change, words):
    geometry, _, _ = random_geometry(np.random.default_rng(0), 3)
    with pytest.raises(AcquisitionError, match=words):
        replace(geometry, **change)


@pytest.mark.parametrize(
    ("model", "distortion"), [("opencv", (-0.25, 0.05, 0.002, -0.001, 0.01)), ("fisheye", (0.01, 0.0, 0.0, 0.0))]
)
def test_lenses_bend_every_ray(model, distortion):
    """Each pixel of a bent camera is what a pinhole of one pixel sees along its rays, moving shapes and shadows too."""
    geometry, rotations, positions = random_geometry(np.random.default_rng(5), 8)
    bent = replace(camera(), lens_model=model, distortion=distortion)
    caster = Raycaster(geometry, bent, (rotations, positions), samples=2)
    found = caster.frames(rotations[None], positions[None], np.ones(1))
    rng = np.random.default_rng(0)
    for row, column in zip(rng.integers(bent.height, size=60), rng.integers(bent.width, size=60), strict=True):
        sums = []
        for y, x in ((0.5, 0.5), (0.25, 0.25), (0.25, 0.75), (0.75, 0.25), (0.75, 0.75)):
            slope = bent.slopes(np.array([[column + x, row + y]]))[0]
            pinhole = replace(bent.pinhole(), width=1, height=1, fx=2 * bent.fx, fy=2 * bent.fy)  # spaced as two rays
            middle = {"cx": 0.5 - slope[0] * pinhole.fx, "cy": 0.5 - slope[1] * pinhole.fy}
            one = Raycaster(geometry, replace(pinhole, **middle), (rotations, positions), samples=1)
            sums.append(one.frames(rotations[None], positions[None], np.ones(1)))
        light = np.mean([frame.intensity[0, 0, 0] for frame in sums[1:]])
        assert found.intensity[0, row, column] == pytest.approx(light, abs=1e-6)
        np.testing.assert_allclose(found.depth[0, row, column], sums[0].depth[0, 0, 0], rtol=1e-6)
        assert found.ids[0, row, column] == sums[0].ids[0, 0, 0]


def test_a_folded_lens_is_refused_and_so_are_poses_of_another_scene():
    thing = one(Shape("sphere", (0.5,), PLAIN))
    with pytest.raises(AcquisitionError, match="cam11: found a lens that folds inside the picture"):
        thing.render(replace(camera(), distortion=(-9.0, 0, 0, 0)), np.zeros(1))
    with pytest.raises(AcquisitionError, match="poses"):
        thing.raycaster(camera(), 2).intensity(np.zeros((1, 2, 3, 3)), np.zeros((1, 2, 3)), np.ones(1))
    with pytest.raises(AcquisitionError, match="gains"):
        thing.raycaster(camera(), 2).intensity(np.zeros((1, 1, 3, 3)), np.zeros((1, 1, 3)), np.ones(2))


@pytest.mark.parametrize(
    ("kind", "size"), [("box", (1, 1)), ("sphere", (-1.0,)), ("sphere", (math.nan,)), ("cone", (1,))]
)
def test_impossible_shapes_are_refused(kind, size):
    with pytest.raises(AcquisitionError, match="expected"):
        Shape(kind, size, PLAIN)
