"""Calibrations of rigs: asked for, listed, checked, and chosen."""

from __future__ import annotations

import logging
import tomllib
from pathlib import Path

import numpy as np

from acquisition.errors import DiskError
from rigs.errors import RigError
from rigs.rig import Rig
from rigs.toml import dump_rig, parse_rig
from server.errors import NotFoundError, PreconditionError, PreconditionRequiredError, UnknownReferenceError
from server.etags import matches, tag
from server.schemas.calibrations import (
    Calibration,
    CalibrationChoice,
    CalibrationInfo,
    CalibrationRequest,
    Calibrations,
    CurrentCalibration,
    RigCheckRequest,
)
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import CalibrateRequest, CheckRigRequest
from server.services.captures import RigService
from server.services.jobs import JobService
from server.services.queue import Key, Queue
from server.store.calibrations import Current, Found, StoredCalibration
from server.store.rig_files import fitted
from server.store.store import Store

_LOG = logging.getLogger(__name__)
_FARTHEST_M = 1000.0
_MOST_DOTS = 64  # of a line
_LONGEST = 300  # characters of a fault in an uploaded file


class CalibrationService:
    """The calibrations of a service's rigs; every method raises NotFoundError for an unknown rig."""

    def __init__(self, store: Store, queue: Queue, rigs: RigService, jobs: JobService) -> None:
        self._store = store
        self._queue = queue
        self._rigs = rigs
        self._jobs = jobs

    def submit(self, rig_id: str, request: CalibrationRequest, key: Key = None) -> str:
        """Queue a calibration, after a recording where `ticks` are asked for; the id of its job.

        Raises RigMismatchError for a capture of other cameras, RigBusyError, and what JobService.submit raises.
        """
        self._rigs.rig(rig_id)
        (job_id,) = self._queue.ids("job", [request], key, f"calibrations of {rig_id}")
        if self._queue.known(job_id):
            return job_id
        capture = request.capture or request.flat
        if request.ticks is not None:
            length = CaptureRequest(ticks=request.ticks, name=request.name)
            capture = self._rigs.start(rig_id, length, key and f"capture of {job_id}")
        wanted = CalibrateRequest(
            type="calibrate",
            capture=capture or "",
            dark=request.dark,
            board=request.board,
            rig=rig_id,
            apply=request.apply,
            name=request.name,
            priority=request.priority,
        )
        self._jobs.add({job_id: wanted}, waits=request.ticks is not None)
        return job_id

    def check(self, rig_id: str, request: RigCheckRequest, key: Key = None) -> str:
        """Queue a comparison of the current calibration with a capture; the id of its job."""
        self._rigs.rig(rig_id)
        fields = request.model_dump() | {"type": "check-rig", "rig": rig_id}
        return self._jobs.submit([CheckRigRequest.model_validate(fields)], key)[0]

    def list(self, rig_id: str) -> Calibrations:
        """All versions, newest first."""
        self._rigs.rig(rig_id)
        return Calibrations(
            items=[CalibrationInfo.model_validate(_info(one)) for one in self._store.calibrations.of(rig_id)]
        )

    def get(self, rig_id: str, version: int) -> Calibration:
        """One version, 0 for the nominal rig; raises NotFoundError."""
        return Calibration.model_validate(self._shown(rig_id, self._version(rig_id, version)))

    def document(self, rig_id: str, version: int) -> StoredCalibration:
        """One version with its RIG.toml; raises NotFoundError."""
        return self._version(rig_id, version)

    def picture(self, rig_id: str, version: int) -> Path:
        """The picture of a version's residuals; raises NotFoundError."""
        found = self._picture(self._version(rig_id, version))
        if found is None:
            raise NotFoundError(f"found no picture of calibration {version}", "one found from a scene or board")
        return found

    def current(self, rig_id: str) -> CurrentCalibration:
        """The calibration in use."""
        rig = self._rigs.rig(rig_id)
        now, stored = self._store.calibrations.current(rig_id)
        shown = self._shown(rig_id, stored or _nominal(rig_id, rig))
        return CurrentCalibration.model_validate(shown | {"revision": now.revision})

    def choose(self, rig_id: str, choice: CalibrationChoice, if_match: str | None) -> CurrentCalibration:
        """Use another version or an uploaded rig file.

        Raises PreconditionRequiredError without If-Match, PreconditionError where it names another revision,
        UnknownReferenceError for a version that is not there, RigError and RigMismatchError for a file of no use.
        """
        rig = self._rigs.rig(rig_id)
        now, _ = self._store.calibrations.current(rig_id)
        if if_match is None:
            raise PreconditionRequiredError(
                "found no If-Match", f"the ETag of GET /v1/rigs/{rig_id}/calibration: it says what is changed"
            )
        if not matches(if_match, etag_of(rig_id, now)):
            raise PreconditionError(
                f"found If-Match {if_match[:60]}",
                f"{etag_of(rig_id, now)}: the calibration has changed",
                "look at it again",
            )
        expected = None if if_match.strip() == "*" else now.revision
        if choice.toml is not None:
            document = dump_rig(_uploaded(choice.toml, rig))
            found = Found("uploaded", {"summary": "uploaded"})
            self._store.calibrations.add(rig_id, found, lambda _: document, apply=True, expected=expected)
        else:
            self._apply(rig_id, choice.version or 0, expected)
        try:
            self._store.rig_files.refresh(rig_id)
        except (DiskError, OSError):  # it is chosen all the same: the worker writes the file before it records
            _LOG.exception("the file of the calibration of %s is not up to date", rig_id)
        return self.current(rig_id)

    def _apply(self, rig_id: str, version: int, expected: int | None) -> None:
        try:
            self._store.calibrations.apply(rig_id, version, expected)
        except NotFoundError as error:
            raise UnknownReferenceError(str(error)) from error

    def _version(self, rig_id: str, version: int) -> StoredCalibration:
        rig = self._rigs.rig(rig_id)
        return self._store.calibrations.get(rig_id, version) if version else _nominal(rig_id, rig)

    def _picture(self, stored: StoredCalibration) -> Path | None:
        path = self._store.rig_files.picture(stored.rig, stored.job) if stored.job else None
        return path if path is not None and path.is_file() else None

    def _shown(self, rig_id: str, stored: StoredCalibration) -> dict[str, object]:
        found = tomllib.loads(stored.document).get("calibration", {})
        poses = stored.source in ("natural", "board")
        return _info(stored) | {
            "residual_px": found.get("residual_px"),
            "rotation_sd_deg": found.get("rotation_sd_deg"),
            "cameras": stored.report.get("cameras", {}) if poses else {},
            "report": stored.report,
            "picture": self._picture(stored) is not None,
        }


def etag_of(rig_id: str, current: Current) -> str:
    """The entity tag of a rig's current calibration."""
    return tag(rig_id, current.revision)


def _info(stored: StoredCalibration) -> dict[str, object]:
    names = ("rig", "version", "source", "job", "sha256")
    kept = {name: getattr(stored, name) for name in names}
    return kept | {"created": stored.created or None, "poses": stored.poses}


def _nominal(rig_id: str, rig: Rig) -> StoredCalibration:
    """The rig as it was drawn, as a version."""
    return StoredCalibration.of(rig_id, 0, "", Found("nominal", {"summary": "as drawn"}), dump_rig(rig))


def _uploaded(text: str, rig: Rig) -> Rig:
    if max(line.count(".") for line in text.split("\n")) > _MOST_DOTS:  # deep keys take the parser minutes
        raise RigError(f"found a line of more than {_MOST_DOTS} dots", "a rig file", "break the line", where="toml")
    try:
        found = parse_rig(text, "toml", None)
    except RigError as error:
        raise RigError(" ".join(str(error).split())[:_LONGEST]) from error
    for camera in found.cameras:
        if np.abs(camera.cam_from_rig.translation).max() > _FARTHEST_M:
            raise RigError(f"found it more than {_FARTHEST_M:g} m away", "metres", where=camera.id)
    return fitted(found, rig)
