"""A client's requests about captures and uploads."""

import hashlib
from pathlib import Path

from server.calls.transport import Transport, at_rig
from server.errors import UploadSizeError
from server.schemas.captures import Capture, CaptureRequest, Captures, ImportRequest, Labels, ManifestInfo
from server.schemas.pictures import CaptureFigures
from server.schemas.uploads import Inspection, LayoutAsked, Upload, UploadRequest, Uploads

_PIECE_BYTES = 16 << 20


class CaptureCalls(Transport):
    """Makes captures, by recording or of files that it sends, and looks at them."""

    def start_capture(self, rig_id: str, request: CaptureRequest) -> Capture:
        """Record."""
        return self._post(f"{at_rig(rig_id)}/captures", Capture, request)

    def stop_capture(self, capture: Capture) -> Capture:
        """End a recording and keep what it has."""
        return self._post(f"{at_rig(str(capture.rig))}/captures/{capture.id}/stop", Capture)

    def save_capture(self, capture: Capture) -> Capture:
        """Keep what the pre-trigger holds, and record on from there."""
        return self._post(f"{at_rig(str(capture.rig))}/captures/{capture.id}/save", Capture)

    def captures(self, **filters: str | int) -> list[Capture]:
        """List captures, newest first; filters: `rig`, `name`, `status`, `q`, `cursor`, `limit`."""
        return self._get("/captures", Captures, **filters).items

    def capture(self, capture_id: str) -> Capture:
        """Return one capture."""
        return self._get(f"/captures/{capture_id}", Capture)

    def label_capture(self, capture_id: str, labels: Labels) -> Capture:
        """Give a capture another name or a note."""
        return self._ask(Capture, "PATCH", f"/captures/{capture_id}", json=labels.model_dump(exclude_unset=True))

    def finalise_capture(self, capture_id: str) -> Capture:
        """Make a recording of the planes that a recorder which failed has left."""
        return self._post(f"/captures/{capture_id}/finalise", Capture)

    def delete_capture(self, capture_id: str) -> None:
        """Delete a capture with its recording."""
        self._send("DELETE", f"/captures/{capture_id}")

    def import_capture(self, request: ImportRequest) -> Capture:
        """Make a capture of committed uploads."""
        return self._post("/captures:import", Capture, request)

    def cancel_import(self, capture_id: str) -> Capture:
        """Give up an import."""
        return self._post(f"/captures/{capture_id}/cancel", Capture)

    def manifest(self, capture_id: str) -> ManifestInfo:
        """Tell what a capture holds and lacks."""
        return self._get(f"/captures/{capture_id}/manifest", ManifestInfo)

    def preview(self, capture_id: str, camera_id: str | None = None) -> bytes:
        """Return a PNG of all cameras of a capture, or of one of them."""
        camera = "" if camera_id is None else f"/{camera_id}"
        return self._send("GET", f"/captures/{capture_id}/preview{camera}").content

    def figures(self, capture_id: str) -> CaptureFigures:
        """Tell how sharp and how bright each camera's preview is."""
        return self._get(f"/captures/{capture_id}/figures", CaptureFigures)

    def capture_log(self, capture_id: str) -> str:
        """Return the log of making a capture."""
        return self._send("GET", f"/captures/{capture_id}/log").text

    def begin_upload(self, request: UploadRequest) -> Upload:
        """Begin an upload."""
        return self._post("/uploads", Upload, request)

    def uploads(self, **filters: str | int) -> list[Upload]:
        """List uploads, newest first; filters: `cursor`, `limit`."""
        return self._get("/uploads", Uploads, **filters).items

    def upload(self, upload_id: str) -> Upload:
        """Return one upload and how much of it has arrived."""
        return self._get(f"/uploads/{upload_id}", Upload)

    def append(self, upload_id: str, data: bytes, offset: int) -> Upload:
        """Send a piece of an upload."""
        headers = {"Upload-Offset": str(offset)}
        return self._ask(Upload, "PATCH", f"/uploads/{upload_id}", content=data, headers=headers)

    def commit_upload(self, upload_id: str) -> Upload:
        """Finish an upload; the service takes a while to read a long one."""
        return self._post(f"/uploads/{upload_id}/commit", Upload, timeout=None)

    def inspect_upload(self, upload_id: str, **size: int) -> Inspection:
        """Tell which layouts an upload may have; `size` is its `width` and `height`, where they are known."""
        return self._get(f"/uploads/{upload_id}/inspection", Inspection, **size)

    def upload_preview(self, upload_id: str, asked: LayoutAsked) -> bytes:
        """Return a picture of an upload in a layout, as PNG."""
        query = asked.model_dump(exclude_none=True)
        return self._send("GET", f"/uploads/{upload_id}/preview", params=query).content

    def delete_upload(self, upload_id: str) -> None:
        """Delete an upload, committed or not."""
        self._send("DELETE", f"/uploads/{upload_id}")

    def send_file(self, path: Path, upload_id: str | None = None) -> Upload:
        """Upload a file and commit it; `upload_id` names an interrupted upload to go on with.

        Raises UploadSizeError where the file is shorter than that upload.
        """
        with path.open("rb") as file:
            if upload_id is None:
                sha256 = hashlib.file_digest(file, "sha256").hexdigest()
                size = path.stat().st_size
                upload = self.begin_upload(UploadRequest(name=path.name[-80:], bytes=size, sha256=sha256))
            else:
                upload = self.upload(upload_id)
            while upload.offset < upload.bytes:
                file.seek(upload.offset)
                piece = file.read(_PIECE_BYTES)
                if not piece:
                    found = f"found {path} to end at byte {path.stat().st_size}"
                    expected = f"the {upload.bytes} bytes of {upload.id}"
                    raise UploadSizeError(found, expected, "give the file that the upload was begun with")
                upload = self.append(upload.id, piece, upload.offset)
        return self.commit_upload(upload.id)
