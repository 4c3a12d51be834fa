"""Draws a setting with Mitsuba: area lamps by shadow rays, mirrors followed sharply, and what surfaces pass on.

A pixel is the mean of RAYS x RAYS rays. Each takes one place on a lamp, the same in every frame, so that what does not
change is the same to the last bit. Letters: n rays, N pixels, K keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquisition.scenes.realistic.library import drjit, mitsuba
from acquisition.scenes.realistic.passed_on import PassedOn
from acquisition.scenes.realistic.pictures import picture
from acquisition.scenes.realistic.setting import Finish, Setting, Thing
from acquisition.scenes.realistic.surfaces import COLUMNS, OBJECT
from rigs.camera import Camera

RAYS = 6  # a side of a pixel where something moves
COARSE_RAYS = 2  # to find where that is


class Painter:
    """A setting in Mitsuba's hands; `stand` puts its movers where they are at an instant."""

    def __init__(self, setting: Setting):
        self._mi, self._dr = mitsuba(), drjit()
        self.setting = setting
        described = _lights(self._mi, setting)
        for number, thing in enumerate(setting.things):
            described[f"thing{number}"] = _shape(self._mi, f"thing{number}", thing)
        self.whole = self._mi.load_dict(described, optimize=False)
        self._movers = [(n, thing) for n, thing in enumerate(setting.things) if thing.moving]
        for number, _ in self._movers:
            del described[f"thing{number}"]
        self.still = self._mi.load_dict(described, optimize=False)
        self._parameters = self._mi.traverse(self.whole)
        self._surfaces = {id(scene): self._table(scene) for scene in (self.whole, self.still)}
        self._instant_s: float | None = None
        self.passed_on = PassedOn(setting)
        self.passed_on.fill(self)

    def stand(self, instant_s: float) -> None:
        """Put the movers where they are at `instant_s`."""
        if instant_s == self._instant_s:
            return
        for number, thing in self._movers:
            flat = np.ascontiguousarray(thing.vertices(instant_s), dtype=np.float32).ravel()
            self._parameters[f"thing{number}.vertex_positions"] = self._mi.Float(flat)
        self._parameters.update()
        self._instant_s = instant_s

    def surface(self, scene: Any, hit: Any, column: int) -> Any:
        """Return a column of the table of surfaces for what the rays hit [n]."""
        dr = self._dr
        index = dr.reinterpret_array(self._mi.UInt32, hit.shape)
        return dr.gather(self._mi.Float, self._surfaces[id(scene)], index * COLUMNS + column, hit.is_valid())

    def _table(self, scene: Any) -> Any:
        """Return what is known of each shape, by its number in Mitsuba's registry."""
        mi, dr, things = self._mi, self._dr, {f"thing{n}": thing for n, thing in enumerate(self.setting.things)}
        numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in scene.shapes()]
        table = np.zeros((max(numbers) + 1, COLUMNS), dtype=np.float32)
        for number, shape in zip(numbers, scene.shapes(), strict=True):
            if thing := things.get(shape.id()):
                finish, body = thing.finish, self.setting.object_ids[thing.body]
                coat = (0, 0) if finish.gloss is None else (1, finish.gloss)
                table[number] = (body, thing.moving, *coat, finish.mirror)
        return mi.Float(table.ravel())


@dataclass(frozen=True, eq=False)
class Picture:
    """Light [N] of N pixels, and the share of each that movers cover [N]."""

    light: NDArray[np.float32]
    covered: NDArray[np.float32]


def paint(painter: Painter, scene: Any, camera: Camera, pixels: NDArray[np.uint32], rays: int, seed: int) -> Picture:
    """Draw `pixels` [N], numbers in row-major order, by `rays` x `rays` rays each, in one of the painter's scenes."""
    from acquisition.scenes.realistic.rays import Rays, radiance

    mi, dr, many = mitsuba(), drjit(), rays * rays
    if not len(pixels):
        return Picture(np.zeros(0, np.float32), np.zeros(0, np.float32))
    numbers = mi.UInt32(pixels) + dr.opaque(mi.UInt32, 0)  # a copy: where NumPy's memory begins would enter the code
    dr.eval(numbers)
    light, covered = radiance(painter, scene, Rays.through(camera, numbers, rays, seed))
    dr.eval(light, covered)
    sums = dr.block_sum(light, many) / many, dr.block_sum(covered, many) / many
    dr.eval(*sums)
    return Picture(*(np.array(values, dtype=np.float32) for values in sums))


def look(painter: Painter, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
    """Return depth along z (NaN where nothing is) and object of each pixel's centre ray [H, W], where movers stand."""
    from acquisition.scenes.realistic.rays import center_rays

    ray, forward = center_rays(camera)
    hit = painter.whole.ray_intersect(ray)
    depth = np.array(hit.t * forward, dtype=np.float32)
    objects = np.array(painter.surface(painter.whole, hit, OBJECT))
    nothing = ~np.array(hit.is_valid() & (painter.surface(painter.whole, hit, OBJECT) > 0), dtype=bool)
    depth[nothing], objects[nothing] = np.nan, 0
    return depth.reshape(camera.height, camera.width), objects.astype(np.int8).reshape(camera.height, camera.width)


def _shape(mi: Any, name: str, thing: Thing) -> Any:
    mesh = thing.mesh
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "twosided", "inner": _paint(mi, thing.finish)})
    properties.set_id(name)
    counts = len(mesh.vertices), len(mesh.faces)
    shape = mi.Mesh(name, *counts, props=properties, has_vertex_texcoords=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(mesh.vertices, dtype=np.float32).ravel())
    parameters["faces"] = mi.UInt32(np.ascontiguousarray(mesh.faces, dtype=np.uint32).ravel())
    size = _texels(thing.finish)
    parameters["vertex_texcoords"] = mi.Float(np.ascontiguousarray(mesh.uv / size, dtype=np.float32).ravel())
    parameters.update()
    return shape


def _texels(finish: Finish) -> NDArray[np.float64]:
    """Return the width and height of the whole picture in the mesh's coordinates."""
    if not finish.picture or not finish.texel_m:
        return np.ones(2)
    return finish.texel_m * np.array(picture(finish.picture, finish.shrink).shape[1::-1], dtype=np.float64)


def _paint(mi: Any, finish: Finish) -> dict[str, Any]:
    low, high = finish.albedo
    if not finish.picture:
        return {"type": "diffuse", "reflectance": {"type": "uniform", "value": high}}
    albedo = low + (high - low) * picture(finish.picture, finish.shrink)
    bitmap = {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(albedo)), "raw": True, "wrap_mode": "repeat"}
    return {"type": "diffuse", "reflectance": bitmap}


def _lights(mi: Any, setting: Setting) -> dict[str, Any]:
    """Return the scene without things: its lamps."""
    described: dict[str, Any] = {"type": "scene"}
    for number, lamp in enumerate(setting.lamps):
        across, down = np.array(lamp.across), np.array(lamp.down)
        normal = np.cross(across, down)
        pose = np.eye(4)
        pose[:3] = np.c_[across, down, normal / np.linalg.norm(normal), lamp.center]
        shining = {"type": "area", "radiance": {"type": "uniform", "value": lamp.radiance}}
        described[f"lamp{number}"] = {"type": "rectangle", "to_world": mi.ScalarTransform4f(pose), "emitter": shining}
    return described
