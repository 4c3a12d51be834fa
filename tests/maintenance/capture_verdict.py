"""Judges what a campaign of faults left of captures: each begun once, whole or said to be incomplete, none hidden."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maintenance.capture_clients import Asked

from acquisition.errors import AcquisitionError
from acquisition.recording.finalise import left_planes
from acquisition.recording.manifest import MANIFEST_FILE, RIG_FILE, TRUTH_FOLDER, Manifest
from acquisition.recording.reader import read_manifest
from acquisition.recording.verify import verify
from acquisition.recording.writer import partial_of
from server.schemas.captures import Capture

FAULTS = ("lost", "undone", "unexplained", "doubled", "false_complete", "altered", "hidden", "torn")


@dataclass(frozen=True)
class Left:
    """The contents of the folder `data` after a campaign, and what the campaign knows of it.

    `asked` has the accepted captures and `shown` all that the service tells of, by id. `kept` are the planes that a
    recorder had on the disk when it was killed.
    """

    data: Path
    asked: Mapping[str, Asked]
    shown: Mapping[str, Capture]
    kept: Mapping[str, int]


def judge_captures(left: Left) -> tuple[list[dict[str, Any]], dict[str, int]]:
    """Return a row for each capture, and the counts: of captures by their end, and of each kind of fault."""
    begun = _begun(left.data)
    rows = [_row(left, capture_id, begun[capture_id]) for capture_id in left.asked]
    stray = [{"capture": one, "faults": ["doubled"]} for one in left.shown if one not in left.asked]
    folders = (left.data / "captures").glob("*")
    unknown = {path.name.removesuffix(".partial") for path in folders} - set(left.shown)
    stray += [{"capture": one, "faults": ["hidden"]} for one in unknown]
    ends = Counter(row["status"] for row in rows)
    faults = Counter(fault for row in (*rows, *stray) for fault in row["faults"])
    counts = {"captures": len(rows), **{word: ends[word] for word in ("done", "failed", "cancelled")}}
    counts |= {word: sum(row["manifest"] == word for row in rows) for word in ("complete", "incomplete")}
    counts["cut_off"] = sum(row["capture"] in left.kept for row in rows)
    return rows + stray, counts | {fault: faults[fault] for fault in FAULTS}


def _begun(data: Path) -> Counter[str]:
    """Count how often a recorder was started for each capture."""
    trace = data / "captures.trace"
    lines = [line.split() for line in trace.read_text().splitlines()] if trace.exists() else []
    return Counter(capture_id for command, capture_id, _ in lines if command == "record")


def _row(left: Left, capture_id: str, begun: int) -> dict[str, Any]:
    asked, shown = left.asked[capture_id], left.shown.get(capture_id)
    recording = left.data / "captures" / capture_id
    row = {"capture": capture_id, "request": asked.request, "begun": begun, "manifest": None, "planes": 0}
    faults = ["doubled"] if begun > 1 else []
    if shown is None:
        return row | {"status": "lost", "faults": [*faults, "lost"]}
    if recording.is_dir():
        try:
            manifest = read_manifest(recording)
        except AcquisitionError as error:
            return row | {"status": shown.status, "faults": [*faults, "torn"], "reason": str(error)}
        row |= {"manifest": manifest.status, "planes": max(camera.planes for camera in manifest.cameras)}
        row["reason"] = manifest.reason
        faults += _faults_of_recording(recording, manifest, asked, shown, left.kept.get(capture_id))
    else:
        row["reason"] = shown.error or shown.message
        faults += _faults_of_none(recording, asked, shown)
    return row | {"status": shown.status, "faults": faults}


def _faults_of_recording(
    recording: Path, manifest: Manifest, asked: Asked, shown: Capture, kept: int | None
) -> list[str]:
    faults = []
    if shown.status != "done":
        faults.append("undone" if shown.status in ("queued", "running") else "hidden")
    elif _is_too_little(manifest, asked) if manifest.status == "complete" else not _is_told(manifest, shown):
        faults.append("false_complete")
    if shown.status == "done" and shown.error:
        faults.append("unexplained")
    if kept is not None and max(camera.planes for camera in manifest.cameras) != kept:
        faults.append("altered")
    names = {MANIFEST_FILE, RIG_FILE, TRUTH_FOLDER, *(camera.file for camera in manifest.cameras)}
    if verify(recording) or {path.name for path in recording.iterdir()} - names:
        faults.append("torn")
    if partial_of(recording).exists():
        faults.append("hidden")
    return faults


def _is_too_little(manifest: Manifest, asked: Asked) -> bool:
    """Return whether a recording that is called complete lacks planes, or an order to end or to begin it."""
    planes = {camera.planes for camera in manifest.cameras}
    wanted = asked.request.get("ticks")
    unasked = (wanted is None and not asked.stopped) or ("pre_trigger_ms" in asked.request and not asked.saved)
    gaps = any(camera.gaps for camera in manifest.cameras)
    return unasked or gaps or len(planes) != 1 or (wanted is not None and planes != {wanted}) or planes == {0}


def _is_told(manifest: Manifest, shown: Capture) -> bool:
    """Return whether an incomplete recording says why, and its capture says it too."""
    return bool(manifest.reason) and manifest.reason in shown.message


def _faults_of_none(recording: Path, asked: Asked, shown: Capture) -> list[str]:
    """Return what is wrong with a capture that has no recording."""
    match shown.status:
        case "queued" | "running":
            return ["undone"]
        case "done":
            return ["false_complete"]
    faults = []
    if not (shown.error or shown.message) or (shown.status == "cancelled" and not asked.stopped):
        faults.append("unexplained")
    held = left_planes(recording)
    if held and not (shown.status == "failed" and shown.partial_planes == held):
        faults.append("hidden")
    return faults
