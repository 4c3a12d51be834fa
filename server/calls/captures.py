"""A client's calls about uploads, imports, pictures, and the state of rigs."""

from __future__ import annotations

import hashlib
from pathlib import Path

from server.calls.transport import Transport
from server.schemas.captures import Capture, ImportRequest, ManifestInfo
from server.schemas.job_types import LookRequest, PreflightRequest
from server.schemas.jobs import Job
from server.schemas.rigs import RigStatus
from server.schemas.uploads import Upload, UploadRequest, Uploads

_PIECE_BYTES = 16 << 20


class CaptureCalls(Transport):
    """Sends files, makes captures of them, and looks at captures and rigs."""

    # Uploads

    def begin_upload(self, request: UploadRequest) -> Upload:
        """Begin an upload."""
        return self._post("/uploads", Upload, request)

    def uploads(self, **filters: str | int) -> list[Upload]:
        """Uploads, newest first; `cursor`, `limit`."""
        return self._get("/uploads", Uploads, **filters).items

    def upload(self, upload_id: str) -> Upload:
        """One upload and how much of it has come."""
        return self._get(f"/uploads/{upload_id}", Upload)

    def append(self, upload_id: str, data: bytes, offset: int) -> Upload:
        """Send a piece of an upload."""
        headers = {"Upload-Offset": str(offset)}
        answer = self._http.patch(f"/v1/uploads/{upload_id}", content=data, headers=headers)
        return Upload.model_validate_json(self._checked(answer).content)

    def commit_upload(self, upload_id: str) -> Upload:
        """Say that an upload is whole; a long one takes the service a while to read."""
        request = self._http.build_request("POST", f"/v1/uploads/{upload_id}/commit", timeout=None)
        return Upload.model_validate_json(self._checked(self._http.send(request)).content)

    def delete_upload(self, upload_id: str) -> None:
        """Delete an upload, committed or not."""
        self._checked(self._http.delete(f"/v1/uploads/{upload_id}"))

    def send_file(self, path: Path, upload_id: str | None = None) -> Upload:
        """Upload a file and commit it; `upload_id` goes on with one that broke off."""
        with path.open("rb") as file:
            if upload_id is None:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
                size = path.stat().st_size
                upload = self.begin_upload(UploadRequest(name=path.name[-80:], bytes=size, sha256=sha256))
            else:
                upload = self.upload(upload_id)
            while upload.offset < upload.bytes:
                file.seek(upload.offset)
                upload = self.append(upload.id, file.read(_PIECE_BYTES), upload.offset)
        return self.commit_upload(upload.id)

    # Captures

    def import_capture(self, request: ImportRequest) -> Capture:
        """Make a capture of committed uploads."""
        return self._post("/captures:import", Capture, request)

    def cancel_import(self, capture_id: str) -> Capture:
        """Give up an import."""
        return self._post(f"/captures/{capture_id}/cancel", Capture)

    def manifest(self, capture_id: str) -> ManifestInfo:
        """What a capture holds and lacks."""
        return self._get(f"/captures/{capture_id}/manifest", ManifestInfo)

    def preview(self, capture_id: str, camera_id: str | None = None) -> bytes:
        """All cameras of a capture, or one of them, as PNG."""
        camera = "" if camera_id is None else f"/{camera_id}"
        return self._checked(self._http.get(f"/v1/captures/{capture_id}/preview{camera}")).content

    def capture_log(self, capture_id: str) -> str:
        """What making a capture said."""
        return self._checked(self._http.get(f"/v1/captures/{capture_id}/log")).text

    # Rigs

    def rig_status(self, rig_id: str) -> RigStatus:
        """How a rig is."""
        return self._get(f"/rigs/{rig_id}/status", RigStatus)

    def preflight(self, rig_id: str, request: PreflightRequest | None = None) -> Job:
        """Look at everything that would spoil a recording."""
        return self._post(f"/rigs/{rig_id}/preflight", Job, request)

    def look(self, rig_id: str, request: LookRequest | None = None) -> Job:
        """Take a picture with all cameras."""
        return self._post(f"/rigs/{rig_id}/look", Job, request)

    def look_picture(self, rig_id: str) -> bytes:
        """What the cameras saw at the last look, as PNG."""
        return self._checked(self._http.get(f"/v1/rigs/{rig_id}/look.png")).content
