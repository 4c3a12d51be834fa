"""`recording.json`: what a recording holds, and the digests that prove it."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout

SCHEMA_VERSION = 1
MANIFEST_FILE = "recording.json"
RIG_FILE = "rig.toml"
TRUTH_FOLDER = "truth"
BLOCK_PLANES, BLOCK_BYTES = 80, 1_000_000
MAX_BLOCK_BYTES = 1 << 30
_MAX_SIDE = (1 << 16) - 1

Layer = Literal["device", "link", "ring", "disk"]
Trigger = Literal["line", "software", "import", "box"]
Status = Literal["armed", "recording", "complete", "incomplete"]
UNFINISHED: tuple[Status, ...] = ("armed", "recording")


def block_planes_of(layout: PlaneLayout) -> int:
    """How many planes share one digest: 80, or as many as make a megabyte."""
    return max(1, min(BLOCK_PLANES, BLOCK_BYTES // layout.plane_bytes))


@dataclass(frozen=True)
class Gap:
    """Planes [first_plane, first_plane + planes) were lost in `layer`; they are zeros in the file: time stays right.

    `device`: the camera's own memory overran; `link`: lost on the way to the host; `ring`: the host's memory was full;
    `disk`: the disk refused them.
    """

    first_plane: int
    planes: int
    layer: Layer

    def __post_init__(self) -> None:
        whole = type(self.first_plane) is type(self.planes) is int
        if not whole or self.first_plane < 0 or self.planes < 1 or self.layer not in get_args(Layer):
            raise BadRecordingError(f"found the gap {self}", f"planes from 0 lost in one of {get_args(Layer)}")


@dataclass(frozen=True)
class Conversion:
    """A file that could not be kept bit for bit: its `source_format`, what of it is gone, and its SHA-256.

    `skipped_bytes` lay before the first whole plane; `missing_segments` lists (plane, segments lost from it), whose
    pixels are zero.
    """

    source_format: str
    source_sha256: str
    skipped_bytes: int = 0
    missing_segments: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class CameraFile:
    """One camera's `.dat`: pure planes in the camera's own `layout`, or in ours where it was converted.

    `first_tick` is plane 0 on the rig clock. `block_digests` are xxh3-64 of every `block_planes` planes, `sha256` is of
    the file (None while it is being recorded). `skew_s` is how far its first plane was from the trigger (None where
    nothing measured it), `skew_sd_s` its standard deviation where that was estimated, and `clock` all that was told of
    the camera's clock from sync pulses. `device` is what the camera said of itself: serial, firmware, sensitivity, what
    its link counted, its clock against the host's, and where it came back after it was lost. `partial_bytes` is what an
    imported file held beyond its last whole plane.
    """

    id: str
    file: str
    layout: PlaneLayout
    planes: int
    first_tick: int
    block_planes: int
    block_digests: tuple[str, ...]
    sha256: str | None
    gaps: tuple[Gap, ...] = ()
    skew_s: float | None = None
    partial_bytes: int = 0
    conversion: Conversion | None = None
    skew_sd_s: float | None = None
    clock: dict[str, Any] | None = None
    device: dict[str, Any] | None = None

    def __post_init__(self) -> None:
        whole = type(self.planes) is type(self.block_planes) is int
        if not whole or self.planes < 0 or self.block_planes < 1:
            found = f"found {self.planes} planes, {self.block_planes} a block"
            raise BadRecordingError(f"{found}", "none or more, and at least one a block", where=self.id)
        blocks = -(-self.planes // self.block_planes)
        if len(self.block_digests) != blocks:
            raise BadRecordingError(f"found {len(self.block_digests)} block digests", f"{blocks}", where=self.id)
        if not set("/\0").isdisjoint(self.file) or self.file in ("", ".", ".."):
            raise BadRecordingError(f"found the file {self.file!r}", "a name inside the recording", where=self.id)
        known = 0
        for gap in self.gaps:
            if gap.first_plane < known or gap.first_plane + gap.planes > self.planes:
                raise BadRecordingError(f"found {gap}", f"gaps in order inside {self.planes} planes", where=self.id)
            known = gap.first_plane + gap.planes

    @property
    def drops(self) -> dict[str, int]:
        """Planes lost, by layer."""
        return {layer: sum(g.planes for g in self.gaps if g.layer == layer) for layer in get_args(Layer)}

    @property
    def written(self) -> int:
        """Planes that are in the file as the camera sent them: those offered without those dropped."""
        return self.planes - sum(self.drops.values())


@dataclass(frozen=True)
class Manifest:
    """The whole of `recording.json`; `writer` names the program and version that wrote it.

    `reason` says why an incomplete recording is one. `direct_io` is false where the file system made the writer go
    through the page cache. `trigger_plane` is the plane at which a run with a pre-trigger was told to save.
    `pixels_sha256` are of the pixel calibrations beside the rig, by file name.
    """

    tick_rate_hz: float
    trigger: Trigger
    writer: str
    rig_sha256: str
    cameras: tuple[CameraFile, ...]
    status: Status = "complete"
    reason: str | None = None
    direct_io: bool | None = None
    trigger_plane: int | None = None
    pixels_sha256: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.tick_rate_hz > 0:
            raise BadRecordingError(f"found the tick rate {self.tick_rate_hz} Hz", "a positive number")
        if self.trigger not in get_args(Trigger):
            raise BadRecordingError(f"found the trigger {self.trigger!r}", f"one of {get_args(Trigger)}")
        if self.status not in get_args(Status) or (self.reason is None) != (self.status != "incomplete"):
            found = f"found the status {self.status!r} with the reason {self.reason!r}"
            raise BadRecordingError(f"{found}", f"one of {get_args(Status)}, and a reason where incomplete")
        ids = [camera.id for camera in self.cameras]
        if not ids or len(set(ids)) < len(ids):
            raise BadRecordingError(f"found the cameras {ids}", "at least one, each once")

    def camera(self, camera_id: str) -> CameraFile:
        """The entry of one camera; raises BadRecordingError listing the known ones."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras)
        raise BadRecordingError(f"found no camera {camera_id} in the recording", f"one of {known}")


def dump_manifest(manifest: Manifest) -> str:
    """The manifest as JSON text."""
    document = {"schema_version": SCHEMA_VERSION, **dataclasses.asdict(manifest)}
    for table, camera in zip(document["cameras"], manifest.cameras, strict=True):
        table.update(offered=camera.planes, written=camera.written, drops=camera.drops)
    return json.dumps(document, indent=1) + "\n"


def load_manifest(text: str | bytes) -> Manifest:
    """Read `dump_manifest`'s text; raises BadRecordingError for anything else."""
    try:
        document = json.loads(text)
        version = document.pop("schema_version")
        if version != SCHEMA_VERSION:
            expected = f"expected {SCHEMA_VERSION}; update spike4dgs"
            raise BadRecordingError(f"found schema {version}, {expected}", where=MANIFEST_FILE)
        cameras = tuple(_camera(table) for table in document.pop("cameras"))
        manifest = Manifest(cameras=cameras, **document)
        digests = manifest.pixels_sha256.items()
        texts = (
            manifest.writer,
            manifest.rig_sha256,
            manifest.reason or "",
            *(text for pair in digests for text in pair),
        )
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("found values of another kind")
        if not all(set("/\0").isdisjoint(name) for name in manifest.pixels_sha256):
            raise ValueError("found a pixel calibration outside the recording")
        return manifest
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadRecordingError(f"found no manifest ({error})", "what spike4dgs writes", where=MANIFEST_FILE) from error


def _camera(table: dict[str, Any]) -> CameraFile:
    table = dict(table)
    drops = table.pop("drops")
    offered, written = table.pop("offered", None), table.pop("written", None)
    layout = PlaneLayout(**table.pop("layout"))
    gaps = tuple(Gap(**gap) for gap in table.pop("gaps"))
    digests = tuple(table.pop("block_digests"))
    conversion = _conversion(table.pop("conversion", None))
    camera = CameraFile(layout=layout, gaps=gaps, block_digests=digests, conversion=conversion, **table)
    _check_kinds(camera)
    if drops != {layer: lost for layer, lost in camera.drops.items() if lost or layer in drops}:
        raise BadRecordingError(f"found the drops {drops}", f"{camera.drops} as the gaps say", where=camera.id)
    if (offered, written) not in ((None, None), (camera.planes, camera.written)):
        found = f"found {offered} planes offered, {written} written"
        raise BadRecordingError(f"{found}", f"{camera.planes} and {camera.written} as the gaps say", where=camera.id)
    return camera


def _conversion(table: dict[str, Any] | None) -> Conversion | None:
    if table is None:
        return None
    missing = tuple((int(plane), int(segments)) for plane, segments in table.pop("missing_segments"))
    return Conversion(missing_segments=missing, **table)


def _check_kinds(camera: CameraFile) -> None:
    """Raise TypeError for what JSON can hold and a camera's entry cannot."""
    texts = (camera.id, camera.file, *camera.block_digests, *([] if camera.sha256 is None else [camera.sha256]))
    layout = camera.layout
    numbers = (camera.first_tick, camera.partial_bytes, layout.width, layout.height, layout.trailing_columns)
    if not all(isinstance(text, str) for text in texts) or not all(type(number) is int for number in numbers):
        raise TypeError("found values of another kind")
    if not all(table is None or isinstance(table, dict) for table in (camera.clock, camera.device)):
        raise TypeError("found a clock or a device of another kind")
    if not all(text.isprintable() for text in (camera.id, camera.file)):
        raise ValueError("found a name that cannot be printed")
    numbers_or_none = (camera.skew_s, camera.skew_sd_s)
    if not all(number is None or isinstance(number, float | int) for number in numbers_or_none):
        raise TypeError("found values of another kind")
    too_many = camera.block_planes > 1 and camera.block_planes * layout.plane_bytes > MAX_BLOCK_BYTES
    if too_many or max(layout.stored_width, layout.height) > _MAX_SIDE:
        raise ValueError(f"found {camera.block_planes} planes of {layout.width}x{layout.height} in a block")
