"""Errors of estimated cameras against the true ones, once a similarity has laid one rig on the other."""

from dataclasses import dataclass

import numpy as np

from rigs.rig import Rig
from rigs.similarity import align
from rigs.transform import Floats, rotvec_of


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Errors after alignment: of each shared camera, and of the focal lengths.

    `turns_rad` [C, 3] in camera axes and `shifts_m` [C, 3] in the true rig's; `translation_percent` is against
    `distance_m`, the mean distance from a camera to the object.
    """

    turns_rad: Floats
    shifts_m: Floats
    focal_percent: float
    distance_m: float

    @property
    def rotation_deg(self) -> float:
        """Return the mean angle between estimated and true camera axes."""
        return float(np.degrees(np.linalg.norm(self.turns_rad, axis=1)).mean())

    @property
    def translation_percent(self) -> float:
        """Return the mean distance of estimated from true centres, in percent of the distance to the object."""
        return float(100 * np.linalg.norm(self.shifts_m, axis=1).mean() / self.distance_m)


def pose_errors(estimated: Rig, true: Rig, distance_m: float) -> PoseErrors:
    """Compare the cameras that both rigs have, as `rigs.similarity.align` aligns them; `distance_m` to the object."""
    moved = align(estimated, true).carry_rig(estimated)
    pairs = [(camera, true.camera(camera.id)) for camera in moved.cameras if camera.id in true.ids]
    turns = [rotvec_of(a.cam_from_rig.rotation @ b.cam_from_rig.rotation.T) for a, b in pairs]
    shifts = [a.center - b.center for a, b in pairs]
    focal = np.mean([abs(a.fx / b.fx - 1) for a, b in pairs])
    return PoseErrors(np.array(turns), np.array(shifts), 100 * float(focal), distance_m)
