"""The numbers of a camera that a renderer needs."""

from dataclasses import dataclass

from reconstruction.errors import ReconstructionError
from rigs.camera import Camera


@dataclass(frozen=True)
class Pinhole:
    """A distortion-free camera; lengths in pixels, `cam_from_world` row-major, `near_m` the nearest visible depth."""

    width: int
    height: int
    focal: tuple[float, float]
    principal: tuple[float, float]
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    near_m: float

    def __post_init__(self) -> None:
        if not self.near_m > 0:
            raise ReconstructionError(f"found the near plane at {self.near_m} m", "a positive depth")


def pinhole_of(camera: Camera, near_m: float) -> Pinhole:
    """`camera` as the renderers see it; raises ReconstructionError where its lens distorts."""
    if any(camera.distortion):
        raise ReconstructionError("found lens distortion", "a pinhole", "undistort its images first", where=camera.id)
    return Pinhole(
        camera.width,
        camera.height,
        (camera.fx, camera.fy),
        (camera.cx, camera.cy),
        tuple(camera.cam_from_rig.rotation.ravel().tolist()),
        tuple(camera.cam_from_rig.translation.tolist()),
        near_m,
    )
