"""Calibrations of rigs: asked for, listed, checked, and chosen."""

import logging
import tomllib
from pathlib import Path

import numpy as np

from acquisition.errors import DiskError
from rigs.errors import RigError
from rigs.rig import Rig
from rigs.toml import dump_rig, parse_rig
from server.errors import NotFoundError, PreconditionError, PreconditionRequiredError, referred
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
from server.store.rig_files import fitted
from server.store.store import Store
from server.store.tables import Found, StoredCalibration

_LOG = logging.getLogger(__name__)
_FARTHEST_M = 1000.0
_MOST_DOTS = 64  # of a line
_LONGEST = 100  # characters of each part of a fault in an uploaded file


class CalibrationService:
    """The calibrations of a service's rigs; every method raises NotFoundError for an unknown rig."""

    def __init__(self, store: Store, queue: Queue, rigs: RigService, jobs: JobService) -> None:
        self._store = store
        self._queue = queue
        self._rigs = rigs
        self._jobs = jobs

    def submit(self, rig_id: str, request: CalibrationRequest, key: Key = None) -> str:
        """Queue a calibration, after a recording where `ticks` are asked for; return the id of its job.

        Raises RigMismatchError for a capture of other cameras, RigBusyError, and the errors of `JobService.submit`.
        """
        self._rigs.rig(rig_id)
        job_id, known = self._queue.once("job", request, key, f"calibrations of {rig_id}")
        if known:
            return job_id
        capture = request.capture or request.flat
        if request.ticks is not None:
            length = CaptureRequest(ticks=request.ticks, name=request.name)
            capture = self._rigs.start(rig_id, length, key and f"capture of {job_id}")
        given = request.model_dump(include={"dark", "board", "apply", "name", "priority"})
        wanted = CalibrateRequest(type="calibrate", capture=capture or "", rig=rig_id, **given)
        self._jobs.add({job_id: wanted}, waits=request.ticks is not None)
        return job_id

    def check(self, rig_id: str, request: RigCheckRequest, key: Key = None) -> str:
        """Queue a comparison of the current calibration with a capture; return the id of its job."""
        self._rigs.rig(rig_id)
        return self._jobs.submit([CheckRigRequest(type="check-rig", rig=rig_id, **request.model_dump())], key)[0]

    def list(self, rig_id: str) -> Calibrations:
        """Return all versions, newest first."""
        self._rigs.rig(rig_id)
        found = self._store.calibrations.of(rig_id)
        return Calibrations(items=[CalibrationInfo.model_validate(one, from_attributes=True) for one in found])

    def get(self, rig_id: str, version: int) -> Calibration:
        """Return one version, 0 for the nominal rig; raises NotFoundError."""
        return Calibration.model_validate(self._shown(self.document(rig_id, version)))

    def document(self, rig_id: str, version: int) -> StoredCalibration:
        """Return one version with its RIG.toml; raises NotFoundError."""
        rig = self._rigs.rig(rig_id)
        return self._store.calibrations.get(rig_id, version) if version else _nominal(rig_id, rig)

    def picture(self, rig_id: str, version: int) -> Path:
        """Return the picture of a version's residuals; raises NotFoundError."""
        found = self._picture(self.document(rig_id, version))
        if found is None:
            raise NotFoundError(f"found no picture of calibration {version}", "one found from a scene or board")
        return found

    def current(self, rig_id: str) -> CurrentCalibration:
        """Return the calibration in use."""
        rig = self._rigs.rig(rig_id)
        now, stored = self._store.calibrations.current(rig_id)
        shown = self._shown(stored or _nominal(rig_id, rig))
        return CurrentCalibration.model_validate(shown | {"revision": now.revision})

    def choose(self, rig_id: str, choice: CalibrationChoice, if_match: str | None) -> CurrentCalibration:
        """Use another version or an uploaded rig file.

        Raises PreconditionRequiredError without If-Match, PreconditionError where it names another revision,
        UnknownReferenceError for a version that is not there, RigError and RigMismatchError for a file of no use.
        """
        rig = self._rigs.rig(rig_id)
        expected = self._expected(rig_id, if_match)
        if choice.toml is not None:
            document = dump_rig(_uploaded(choice.toml, rig))
            found = Found("uploaded", {"summary": "uploaded"})
            self._store.calibrations.add(rig_id, found, lambda _: document, apply=True, expected=expected)
        else:
            with referred():
                self._store.calibrations.apply(rig_id, choice.version or 0, expected)
        try:
            self._store.rig_files.refresh(rig_id)
        except (DiskError, OSError):  # it is chosen all the same: the worker writes the file before it records
            _LOG.exception("the file of the calibration of %s is not up to date", rig_id)
        return self.current(rig_id)

    def _expected(self, rig_id: str, if_match: str | None) -> int | None:
        """Return the revision that If-Match names, None for any."""
        now, _ = self._store.calibrations.current(rig_id)
        etag = tag(rig_id, now.revision)
        if if_match is None:
            raise PreconditionRequiredError(
                "found no If-Match", f"the ETag of GET /v1/rigs/{rig_id}/calibration: it says what is changed"
            )
        if not matches(if_match, etag):
            expected = f"{etag}: the calibration has changed"
            raise PreconditionError(f"found If-Match {if_match[:60]}", expected, "look at it again")
        return None if if_match.strip() == "*" else now.revision

    def _picture(self, stored: StoredCalibration) -> Path | None:
        path = self._store.rig_files.picture(stored.rig, stored.job) if stored.job else None
        return path if path is not None and path.is_file() else None

    def _shown(self, stored: StoredCalibration) -> dict[str, object]:
        found = tomllib.loads(stored.document).get("calibration", {})
        has_poses = stored.source in ("natural", "board")
        return vars(stored) | {
            "poses": stored.poses,
            "residual_px": found.get("residual_px"),
            "rotation_sd_deg": found.get("rotation_sd_deg"),
            "cameras": stored.report.get("cameras", {}) if has_poses else {},
            "picture": self._picture(stored) is not None,
        }


def _nominal(rig_id: str, rig: Rig) -> StoredCalibration:
    """Return the rig as it was drawn, as a version."""
    return StoredCalibration.of(rig_id, 0, None, Found("nominal", {"summary": "as drawn"}), dump_rig(rig))


def _uploaded(text: str, rig: Rig) -> Rig:
    if max(line.count(".") for line in text.split("\n")) > _MOST_DOTS:  # deep keys take the parser minutes
        raise RigError(f"found a line of more than {_MOST_DOTS} dots", "a rig file", "break the line", where="toml")
    try:
        found = parse_rig(text, "toml", None)
    except RigError as error:  # whose parts may be as long as the file
        found, expected, do, where = (
            " ".join(part.split())[:_LONGEST] for part in (error.found, error.expected, error.do, error.where)
        )
        raise RigError(found, expected, do, where=where) from error
    for camera in found.cameras:
        if np.abs(camera.cam_from_rig.translation).max() > _FARTHEST_M:
            raise RigError(f"found it more than {_FARTHEST_M:g} m away", "metres", where=camera.id)
    return fitted(found, rig)
