"""Cuts a part out of a simulated recording, as a recording of its own with its own truth."""

import json
import shutil
import tempfile
from pathlib import Path

from acquisition.durable import write_json
from acquisition.recording.importing import ImportOptions, import_recording
from acquisition.recording.manifest import RIG_FILE, TRUTH_FOLDER
from acquisition.recording.reader import Recording
from reconstruction.run.spans import Span


def cut_out(recording: Recording, span: Span, out: Path) -> None:
    """Write the planes of `span` as the recording `out`, with the truth of these planes where there is any.

    Raises BadRecordingError where a camera has fewer planes, or `out` exists.
    """
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as folder:
        dats = []
        for camera_id in recording.camera_ids:
            stream = recording.stream(camera_id)
            file = Path(folder) / f"{camera_id}.dat"
            file.write_bytes(stream.window(span.first, span.last).tobytes())
            dats.append(f"{camera_id}={file}")
        layout = recording.manifest.cameras[0].layout
        options = ImportOptions(recording.tick_rate_hz, bit_order=layout.bit_order, row_order=layout.row_order)
        import_recording(dats, recording.path / RIG_FILE, out, options)
    if recording.truth is not None:
        _cut_truth(recording.truth, span, out / TRUTH_FOLDER)


def _cut_truth(truth: Path, span: Span, out: Path) -> None:
    """Copy the truth of the planes of `span`, counted from its first one."""
    for folder in (path for path in truth.iterdir() if path.is_dir()):
        (out / folder.name).mkdir(parents=True)
        for file in folder.glob("*.npy"):
            kind, number = file.stem[:-6], int(file.stem[-6:])
            if span.first <= number < span.last:
                shutil.copyfile(file, out / folder.name / f"{kind}{number - span.first:06d}.npy")
    for file in (path for path in truth.iterdir() if path.is_file() and path.name != "scene.json"):
        shutil.copyfile(file, out / file.name)
    write_json(out / "scene.json", json.loads((truth / "scene.json").read_text()) | {"ticks": len(span)})
