"""Follows rays: light of lamps by one shadow ray each, coats and metals by their mirror ray, up to `bounces` times.

Letters: n rays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from acquisition.scenes.realistic.bent import slopes  # lens
from acquisition.scenes.realistic.library import drjit, mitsuba
from acquisition.scenes.realistic.surfaces import COATED, MIRRORS, MOVES, ROUGH
from rigs.camera import Camera

mi, dr = mitsuba(), drjit()  # this module is imported where something is drawn, and nowhere else
NORMAL_REFLECTANCE = 0.04  # of a clear coat seen straight on
LEAST_WEIGHT = 1e-3  # of a mirror ray that is followed


@dataclass(frozen=True, eq=False)
class Rays:
    """Rays and, for each, a place on the lamps in [0, 1)^2."""

    ray: Any
    lamp: Any

    @classmethod
    def through(cls, camera: Camera, pixels: Any, side: int, seed: int) -> Rays:
        """Spread `side` x `side` rays over each of `pixels`, and their places over the lamps, at random from `seed`."""
        many = side * side
        number = dr.arange(mi.UInt32, many * dr.width(pixels))
        pixel = dr.gather(mi.UInt32, pixels, number // many)
        ray = number % many
        random = [mi.sample_tea_float32(pixel * many + ray, mi.UInt32(seed * 4 + k), 4) for k in range(4)]
        turned = (ray * 7 + mi.sample_tea_32(pixel, mi.UInt32(seed), 4)[0] % many) % many
        x = (mi.Float(ray % side) + random[0]) / side + mi.Float(pixel % camera.width)
        y = (mi.Float(ray // side) + random[1]) / side + mi.Float(pixel // camera.width)
        lamp = mi.Point2f((mi.Float(turned % side) + random[2]) / side, (mi.Float(turned // side) + random[3]) / side)
        return cls(_rays(camera, x, y)[0], lamp)


def center_rays(camera: Camera) -> tuple[Any, Any]:
    """Return the ray through the middle of each pixel, and how far it gets along the camera's z for each metre."""
    number = dr.arange(mi.UInt32, camera.width * camera.height)
    return _rays(camera, mi.Float(number % camera.width) + 0.5, mi.Float(number // camera.width) + 0.5)


def _rays(camera: Camera, x: Any, y: Any) -> tuple[Any, Any]:
    fx, fy, cx, cy = (_number(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    seen = dr.normalize(mi.Vector3f((x - cx) / fx, (y - cy) / fy, 1))
    seen = dr.normalize(mi.Vector3f(*slopes(camera, x, y), 1)) if camera.bends else seen  # lens
    turn = [mi.Vector3f(*map(_number, row)) for row in camera.cam_from_rig.rotation.T]
    direction = mi.Vector3f(*(dr.dot(row, seen) for row in turn))
    center = mi.Point3f(*map(_number, camera.center))
    return mi.Ray3f(center + dr.zeros(mi.Point3f, dr.width(x)), direction), seen.z


def _number(value: float) -> Any:
    """Return a number that the compiled code reads rather than holds: one code for all cameras."""
    return dr.opaque(mi.Float, float(value))


def radiance(painter: Any, scene: Any, rays: Rays, lit: bool = True) -> tuple[Any, Any]:
    """Return the light that comes back along each ray [n], and whether a mover is the first that it meets [n].

    Rays that are not `lit` do not see the lamps themselves.
    """
    ray, light, weight = rays.ray, mi.Float(0), mi.Float(1)
    active, covered = mi.Mask(True), mi.Float(0)
    for bounce in range(painter.setting.bounces):
        hit = scene.ray_intersect(ray, active)
        if lit or bounce:
            shining = hit.emitter(scene, active)
            light += weight * dr.select(active & (shining != None), shining.eval(hit, active).x, 0)  # noqa: E711
        active &= hit.is_valid()
        if bounce == 0:
            covered = dr.select(active, painter.surface(scene, hit, MOVES), 0)
        normal = dr.select(dr.dot(hit.sh_frame.n, ray.d) > 0, -hit.sh_frame.n, hit.sh_frame.n)
        seen, sharp = _scattered(painter, scene, Meeting(hit, ray.d, normal, rays.lamp), active)
        light += weight * seen
        if bounce + 1 < painter.setting.bounces:
            weight *= sharp
            active &= weight > LEAST_WEIGHT
            ray = hit.spawn_ray(ray.d - 2 * dr.dot(ray.d, normal) * normal)
    return light, covered


@dataclass(frozen=True, eq=False)
class Meeting:
    """Hits of rays along `along` on surfaces whose `normal` faces them, and the place on the lamps of each [n]."""

    hit: Any
    along: Any
    normal: Any
    lamp: Any


def _scattered(painter: Any, scene: Any, met: Meeting, active: Any) -> tuple[Any, Any]:
    """Return the light that surfaces scatter back, and the share of the mirror ray that they add to it.

    It is the light of one place on each lamp and, off what is matt, what other surfaces pass on.
    """
    glossy = painter.setting.glossy
    rough = painter.surface(scene, met.hit, ROUGH) if glossy else mi.Float(0)
    direct, glint = mi.Float(0), mi.Float(0)
    for lamp in scene.emitters():
        towards, strength = lamp.sample_direction(met.hit, met.lamp, active)
        facing = dr.dot(met.normal, towards.d)
        lit = active & (towards.pdf > 0) & (facing > 0)
        lit &= ~scene.ray_test(met.hit.spawn_ray_to(towards.p), lit)
        light = dr.select(lit, facing * strength.x, 0)
        direct += light
        glint += dr.select(rough > 0, _glint(met, towards.d, rough) * light, 0) if glossy else 0
    albedo = met.hit.bsdf().eval_diffuse_reflectance(met.hit, active).x
    matt = albedo * dr.inv_pi * (direct + painter.passed_on.irradiance(met.hit.p, met.normal))
    if not glossy:
        return dr.select(active, matt, 0), mi.Float(0)
    mirror = painter.surface(scene, met.hit, MIRRORS)
    coat = painter.surface(scene, met.hit, COATED) * _fresnel(dr.abs(dr.dot(met.normal, met.along)))
    found = (1 - mirror) * ((1 - coat) * matt + glint)
    return dr.select(active, found, 0), mirror + (1 - mirror) * dr.select(rough > 0, 0, coat)


def _glint(met: Meeting, towards: Any, rough: Any) -> Any:
    """Return what a rough coat reflects of light that faces it: Trowbridge and Reitz, with the shadowing of Smith."""
    half = dr.normalize(towards - met.along)
    into, out = _above(dr.dot(met.normal, towards), 0), _above(-dr.dot(met.normal, met.along), 1e-3)
    square = dr.square(rough)
    spread = square / (dr.pi * dr.square(dr.square(dr.dot(met.normal, half)) * (square - 1) + 1))
    shade = out * dr.sqrt(square + (1 - square) * into * into) + into * dr.sqrt(square + (1 - square) * out * out)
    return _fresnel(_above(dr.dot(half, towards), 0)) * spread / (2 * _above(shade, 1e-6))


def _fresnel(cosine: Any) -> Any:
    """Return the share that a coat reflects, after Schlick."""
    return NORMAL_REFLECTANCE + (1 - NORMAL_REFLECTANCE) * _above(1 - cosine, 0) ** 5


def _above(value: Any, least: float) -> Any:
    """Return the value, or `least` where it is less; LLVM fails now and then on the instruction of `maximum`."""
    return dr.select(value > least, value, least)
