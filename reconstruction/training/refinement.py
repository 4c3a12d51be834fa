"""Learns poses, gains and time lags of the training views beside the Gaussians, where no calibration vouches for them.

A camera is corrected by moving what it sees, so that every renderer serves as it is. The gauge is fixed: no correction
turns, moves or scales all cameras together, brightens all views or delays all clocks. Letters: V views, N Gaussians.
"""

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from reconstruction.calibration.calibrated import aligning
from reconstruction.calibration.projection import Cameras
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.rendering.result import Instantaneous
from rigs.camera import Camera
from rigs.rig import Rig
from rigs.transform import Transform

RATES = {"turns": 1e-4, "shifts": 1e-4, "log_gains": 5e-4, "lags": 0.01}  # rad, scene units, logs, ticks
FINAL = 0.05  # share of the rates that is left at the end of the training


class Refinement:
    """Corrections of V views: `turns` [V, 3] in camera axes, `shifts` [V, 3] in scene units, `log_gains`, `lags` [V].

    `extent_m` is the scene's unit; a lag is in ticks, positive where a camera sees what happens later.
    """

    def __init__(self, cameras: Sequence[Camera], extent_m: float, tick_s: float):
        views = len(cameras)
        self.cameras, self.extent_m, self.tick_s = tuple(cameras), extent_m, tick_s
        self.turns, self.shifts = torch.zeros(views, 3), torch.zeros(views, 3)
        self.log_gains, self.lags = torch.zeros(views), torch.zeros(views)
        self._gauge = torch.from_numpy(aligning(Cameras.of(self.cameras), metric=False)).float()
        self.optimizer = torch.optim.Adam(
            [{"params": [getattr(self, name).requires_grad_(True)], "start": rate} for name, rate in RATES.items()]
        )

    def seen(self, cloud: DynamicCloud, instant_s: float, view: int) -> Instantaneous:
        """Return the cloud moved so that the uncorrected camera sees what the corrected one does."""
        now = cloud.at(instant_s)
        device, camera = now.means.device, self.cameras[view]
        turn = _rotation(self.turns[view].to(device))
        own = torch.from_numpy(camera.cam_from_rig.rotation).float().to(device)
        whole = own.T @ turn @ own
        center = torch.from_numpy(camera.center).float().to(device)
        means = now.means + self._late(cloud, instant_s) * self.lags[view].to(device)
        means = center + (means - center - self.extent_m * self.shifts[view].to(device)) @ whole.T
        return now._replace(
            means=means,
            quats_wxyz=_turned(own.T @ self.turns[view].to(device) / 2, now.quats_wxyz),
            intensities=now.intensities * self.log_gains[view].to(device).exp(),
        )

    def _late(self, cloud: DynamicCloud, instant_s: float) -> Tensor:
        """Return how far everything moves in a tick [N, 3], m."""
        if not len(cloud.moving):
            return torch.zeros(1, 3, device=cloud.still.means.device)
        with torch.no_grad():
            later, earlier = (cloud.at(instant_s + sign * self.tick_s / 2).means for sign in (1, -1))
            return later - earlier

    def step(self, done: float) -> None:
        """Learn from the gradients, then take out what all views share."""
        for group in self.optimizer.param_groups:
            group["lr"] = group["start"] * FINAL ** min(max(done, 0.0), 1.0)
        self.optimizer.step()
        with torch.no_grad():
            steps = torch.cat([self.turns, self.extent_m * self.shifts], dim=1)
            kept = (self._gauge @ steps.flatten()).view(-1, 6)
            self.turns.copy_(kept[:, :3])
            self.shifts.copy_(kept[:, 3:] / self.extent_m)
            self.log_gains -= self.log_gains.mean()
            self.lags -= self.lags.mean()
        self.optimizer.zero_grad(set_to_none=True)

    def refined(self, rig: Rig) -> Rig:
        """Return `rig` with the corrected poses of the views; other cameras stay as they are."""
        found = {}
        for i, camera in enumerate(self.cameras):
            turn = _rotation(self.turns[i].detach().double()).numpy()
            u, _, vt = np.linalg.svd(turn @ camera.cam_from_rig.rotation)
            center = camera.center + self.extent_m * self.shifts[i].detach().double().numpy()
            found[camera.id] = Transform(u @ vt, -(u @ vt) @ center)
        cameras = tuple(replace(c, cam_from_rig=found.get(c.id, c.cam_from_rig)) for c in rig.cameras)
        return replace(rig, cameras=cameras)

    def report(self) -> dict[str, dict[str, float]]:
        """Return the corrections by camera id: degrees, mm, gain as a factor, lag in ticks."""
        turns = torch.rad2deg(self.turns.detach().norm(dim=1)).tolist()
        shifts = (1000 * self.extent_m * self.shifts.detach().norm(dim=1)).tolist()
        gains, lags = self.log_gains.detach().exp().tolist(), self.lags.detach().tolist()
        return {
            camera.id: {"turn_deg": turn, "shift_mm": shift, "gain": gain, "lag_ticks": lag}
            for camera, turn, shift, gain, lag in zip(self.cameras, turns, shifts, gains, lags, strict=True)
        }

    def state(self) -> dict:
        """Return plain tensors and numbers, for a checkpoint."""
        values = {name: getattr(self, name).detach().clone() for name in RATES}
        return {"values": values, "optimizer": copy.deepcopy(self.optimizer.state_dict())}

    def restore(self, state: dict) -> None:
        """Continue from what `state` returned."""
        with torch.no_grad():
            for name, value in state["values"].items():
                getattr(self, name).copy_(value)
        self.optimizer.load_state_dict(state["optimizer"])


def _rotation(turn: Tensor) -> Tensor:
    """Return the rotation [3, 3] of the quaternion (1, turn / 2): a turn by its length in rad where that is small."""
    x, y, z = turn / 2
    matrix = torch.stack(
        [
            *(1 + x * x - y * y - z * z, 2 * (x * y - z), 2 * (x * z + y)),
            *(2 * (x * y + z), 1 - x * x + y * y - z * z, 2 * (y * z - x)),
            *(2 * (x * z - y), 2 * (y * z + x), 1 - x * x - y * y + z * z),
        ]
    )
    return matrix.view(3, 3) / (1 + x * x + y * y + z * z)


def _turned(half: Tensor, quats_wxyz: Tensor) -> Tensor:
    """Return quaternions [N, 4] turned by (1, `half` [3]); their length changes, which renderers do not mind."""
    w, v = quats_wxyz[:, :1], quats_wxyz[:, 1:]
    real = w - (v @ half)[:, None]
    imaginary = v + w * half + torch.linalg.cross(half.expand_as(v), v)
    return torch.cat([real, imaginary], dim=1)
