"""What a client of the service may ask about calibrations."""

from __future__ import annotations

from server.calls.transport import Transport
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
from server.schemas.jobs import Job


class CalibrationCalls(Transport):
    """The part of ServiceClient that is about calibrations."""

    def calibrate(self, rig_id: str, request: CalibrationRequest) -> Job:
        """Queue a calibration of a rig."""
        return self._post(f"/rigs/{rig_id}/calibrations", Job, request)

    def calibrations(self, rig_id: str) -> list[CalibrationInfo]:
        """All calibrations of a rig, newest first."""
        return self._get(f"/rigs/{rig_id}/calibrations", Calibrations).items

    def calibration(self, rig_id: str, version: int) -> Calibration:
        """One calibration; 0 is the rig as it was drawn."""
        return self._get(f"/rigs/{rig_id}/calibrations/{version}", Calibration)

    def calibration_toml(self, rig_id: str, version: int) -> str:
        """The rig file of a calibration."""
        return self._checked(self._http.get(f"/v1/rigs/{rig_id}/calibrations/{version}/rig.toml")).text

    def calibration_picture(self, rig_id: str, version: int) -> bytes:
        """The picture of a calibration's residuals, a PNG."""
        return self._checked(self._http.get(f"/v1/rigs/{rig_id}/calibrations/{version}/picture")).content

    def current_calibration(self, rig_id: str) -> CurrentCalibration:
        """The calibration in use."""
        return self._get(f"/rigs/{rig_id}/calibration", CurrentCalibration)

    def choose_calibration(self, seen: CurrentCalibration, choice: CalibrationChoice) -> CurrentCalibration:
        """Use another version or a rig file instead of the calibration that was `seen`; refused if it has changed."""
        answer = self._http.put(
            f"/v1/rigs/{seen.rig}/calibration",
            json=choice.model_dump(exclude_none=True),
            headers={"If-Match": tag(seen.rig, seen.revision)},
        )
        return CurrentCalibration.model_validate_json(self._checked(answer).content)

    def check_calibration(self, rig_id: str, capture_id: str) -> Job:
        """Queue a comparison of the current calibration with what a capture saw."""
        return self._post(f"/rigs/{rig_id}/calibration/check", Job, RigCheckRequest(capture=capture_id))
