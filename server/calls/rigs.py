"""A client's requests about rigs and their calibrations."""

from server.calls.transport import Transport, at_rig
from server.etags import tag
from server.schemas.calibrations import (
    Calibration,
    CalibrationChoice,
    CalibrationInfo,
    CalibrationRequest,
    Calibrations,
    CurrentCalibration,
    RigCheckRequest,
)
from server.schemas.job_types import LookRequest, PreflightRequest
from server.schemas.jobs import Job
from server.schemas.pictures import LookFigures
from server.schemas.rigs import RigInfo, Rigs, RigStatus


class RigCalls(Transport):
    """Looks at rigs, and asks for and chooses their calibrations."""

    def rigs(self) -> list[RigInfo]:
        """List all rigs."""
        return self._get("/rigs", Rigs).items

    def rig(self, rig_id: str) -> RigInfo:
        """Return one rig."""
        return self._get(at_rig(rig_id), RigInfo)

    def rig_status(self, rig_id: str) -> RigStatus:
        """Tell how a rig is."""
        return self._get(f"{at_rig(rig_id)}/status", RigStatus)

    def preflight(self, rig_id: str, request: PreflightRequest | None = None) -> Job:
        """Check everything that could spoil a recording."""
        return self._post(f"{at_rig(rig_id)}/preflight", Job, request)

    def look(self, rig_id: str, request: LookRequest | None = None) -> Job:
        """Take a picture with all cameras."""
        return self._post(f"{at_rig(rig_id)}/look", Job, request)

    def look_picture(self, rig_id: str, camera_id: str | None = None) -> bytes:
        """Return what all cameras, or one of them, saw at the last look, as PNG."""
        return self._send("GET", f"{at_rig(rig_id)}/look{'.png' if camera_id is None else f'/{camera_id}'}").content

    def look_figures(self, rig_id: str) -> LookFigures:
        """Tell how sharp and how bright each camera's picture of the last look is."""
        return self._get(f"{at_rig(rig_id)}/look", LookFigures)

    def calibrate(self, rig_id: str, request: CalibrationRequest) -> Job:
        """Queue a calibration of a rig."""
        return self._post(f"{at_rig(rig_id)}/calibrations", Job, request)

    def calibrations(self, rig_id: str) -> list[CalibrationInfo]:
        """List all calibrations of a rig, newest first."""
        return self._get(f"{at_rig(rig_id)}/calibrations", Calibrations).items

    def calibration(self, rig_id: str, version: int) -> Calibration:
        """Return one calibration; 0 is the rig as it was drawn."""
        return self._get(f"{at_rig(rig_id)}/calibrations/{version}", Calibration)

    def calibration_toml(self, rig_id: str, version: int) -> str:
        """Return the rig file of a calibration."""
        return self._send("GET", f"{at_rig(rig_id)}/calibrations/{version}/rig.toml").text

    def calibration_picture(self, rig_id: str, version: int) -> bytes:
        """Return the picture of a calibration's residuals, a PNG."""
        return self._send("GET", f"{at_rig(rig_id)}/calibrations/{version}/picture").content

    def current_calibration(self, rig_id: str) -> CurrentCalibration:
        """Return the calibration in use."""
        return self._get(f"{at_rig(rig_id)}/calibration", CurrentCalibration)

    def choose_calibration(self, seen: CurrentCalibration, choice: CalibrationChoice) -> CurrentCalibration:
        """Use another version or a rig file instead of the calibration `seen`; refused if that has changed since."""
        body, headers = choice.model_dump(exclude_none=True), {"If-Match": tag(seen.rig, seen.revision)}
        return self._ask(CurrentCalibration, "PUT", f"{at_rig(seen.rig)}/calibration", json=body, headers=headers)

    def check_calibration(self, rig_id: str, capture_id: str) -> Job:
        """Queue a comparison of the current calibration with a capture."""
        return self._post(f"{at_rig(rig_id)}/calibration/check", Job, RigCheckRequest(capture=capture_id))
