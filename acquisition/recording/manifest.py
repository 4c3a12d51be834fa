"""`recording.json`: the contents of a recording, and the digests that prove them."""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, Literal, get_args, get_origin, get_type_hints

from acquisition.errors import BadRecordingError
from acquisition.spikes.layout import PlaneLayout

SCHEMA_VERSION, COMPACT_VERSION = 1, 2  # of a manifest; of one with compact files, which older programs cannot read
MANIFEST_FILE = "recording.json"
RIG_FILE = "rig.toml"
TRUTH_FOLDER = "truth"
BLOCK_PLANES, BLOCK_BYTES = 80, 1_000_000  # most planes and bytes of a block that are written
NOTE_BYTES = 128  # most bytes of a block's line in the journal and of its digest in the manifest
MAX_BLOCK_BYTES = 1 << 30  # most bytes of a block that are read, where it is more than one plane
MAX_SIDE = (1 << 16) - 1  # most pixels a side

Layer = Literal["device", "link", "ring", "disk"]
Trigger = Literal["line", "software", "import", "box"]
Status = Literal["armed", "recording", "complete", "incomplete"]
UNFINISHED: tuple[Status, ...] = ("armed", "recording")


def block_planes_of(layout: PlaneLayout) -> int:
    """Return how many planes share one digest: 80, or as many as make a megabyte."""
    return max(1, min(BLOCK_PLANES, BLOCK_BYTES // layout.plane_bytes))


def note_bytes(planes: int, layout: PlaneLayout) -> int:
    """Return the bytes that the journal and the manifest of so many planes take at most, where none is lost."""
    return -(-planes // block_planes_of(layout)) * NOTE_BYTES


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
    """A file that could not be kept bit for bit: its format, its SHA-256, and what of it is gone.

    `skipped_bytes` lay before the first whole plane; `missing_segments` lists (plane, segments lost from it), whose
    pixels are zero.
    """

    source_format: str
    source_sha256: str
    skipped_bytes: int = 0
    missing_segments: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class Compact:
    """The file that holds a camera's planes in place of its `.dat`: blocks one behind another (`spikes.compact`).

    `block_bytes` are the lengths of the blocks, of `block_planes` planes each but the last. `coding` is how they are
    made: trains of pixels in Zstandard frames.
    """

    file: str
    block_planes: int
    block_bytes: tuple[int, ...]
    coding: Literal["trains-zstd"] = "trains-zstd"


@dataclass(frozen=True)
class CameraFile:
    """One camera's `.dat`: pure planes in the camera's own `layout`, or in ours where it was converted.

    With `compact` set, another file holds them, and there is no `.dat`; digests are of the planes either way.

    `first_tick` is plane 0 on the rig clock. `block_digests` are xxh3-64 of every `block_planes` planes; `sha256` is of
    the file (None while it is being recorded). `skew_s` is how late its planes come, in the middle of the recording
    (None where nothing measured it), `skew_sd_s` its standard deviation where that was estimated. `clock` holds all
    that sync pulses told of the camera's clock, whose `skew_s` is how far it is ahead: one that is ahead is early.
    `device` holds what the camera said of itself: serial, firmware, sensitivity, the counters of its link, its clock
    against the host's, and where it came back after it was lost. `partial_bytes` counts the bytes of an imported file
    beyond its last whole plane.
    Raises BadRecordingError, naming the camera, for a name, layout, digests or gaps that do not fit.
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
    compact: Compact | None = None

    def __post_init__(self) -> None:
        names = (self.file, self.stored_file)
        if not all(map(str.isprintable, (self.id, *names))) or any("/" in n or n in ("", ".", "..") for n in names):
            raise BadRecordingError(f"found camera {self.id!r}, file {self.file!r}", "names inside the recording")
        if self.planes < 0 or self.block_planes < 1:
            found = f"found {self.planes} planes, {self.block_planes} a block"
            raise BadRecordingError(found, "none or more, and at least one a block", where=self.id)
        block_bytes = self.block_planes * self.layout.plane_bytes
        side = max(self.layout.stored_width, self.layout.height)
        if (self.block_planes > 1 and block_bytes > MAX_BLOCK_BYTES) or side > MAX_SIDE:
            found = f"found {block_bytes} bytes a block, a side of {side} pixels"
            raise BadRecordingError(found, f"at most {MAX_BLOCK_BYTES} and {MAX_SIDE}", where=self.id)
        blocks = -(-self.planes // self.block_planes)
        if len(self.block_digests) != blocks:
            raise BadRecordingError(f"found {len(self.block_digests)} block digests", str(blocks), where=self.id)
        known = 0
        for gap in self.gaps:
            if gap.first_plane < known or gap.first_plane + gap.planes > self.planes:
                raise BadRecordingError(f"found {gap}", f"gaps in order inside {self.planes} planes", where=self.id)
            known = gap.first_plane + gap.planes
        if self.compact:
            self._check_compact(self.compact)

    def _check_compact(self, compact: Compact) -> None:
        most = MAX_BLOCK_BYTES // self.layout.plane_bytes
        if not 1 <= compact.block_planes <= most or min(compact.block_bytes, default=0) < 1:
            found = f"found compact blocks of {compact.block_planes} planes, {compact.block_bytes[:3]} bytes"
            raise BadRecordingError(found, f"1 to {most} planes, and bytes in each", where=self.id)
        blocks = -(-self.planes // compact.block_planes)
        if len(compact.block_bytes) != blocks:
            raise BadRecordingError(f"found {len(compact.block_bytes)} compact blocks", str(blocks), where=self.id)

    @property
    def bytes(self) -> int:
        """Bytes of the planes, as the `.dat` has them."""
        return self.planes * self.layout.plane_bytes

    @property
    def stored_file(self) -> str:
        """The file that holds the planes."""
        return self.compact.file if self.compact else self.file

    @property
    def stored_bytes(self) -> int:
        """Bytes of the file that holds the planes."""
        return sum(self.compact.block_bytes) if self.compact else self.bytes

    @property
    def drops(self) -> dict[str, int]:
        """Planes lost, by layer."""
        return {layer: sum(g.planes for g in self.gaps if g.layer == layer) for layer in get_args(Layer)}

    def lost_within(self, ticks: range) -> int:
        """Return how many of the planes of the contiguous `ticks` were lost."""
        ends = [(self.first_tick + g.first_plane, self.first_tick + g.first_plane + g.planes) for g in self.gaps]
        return sum(max(0, min(ticks.stop, end) - max(ticks.start, begin)) for begin, end in ends)

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
            raise BadRecordingError(found, f"one of {get_args(Status)}, and a reason where incomplete")
        ids = [camera.id for camera in self.cameras]
        if not ids or len(set(ids)) < len(ids):
            raise BadRecordingError(f"found the cameras {ids}", "at least one, each once")
        if any("/" in name or "\0" in name for name in self.pixels_sha256):
            raise BadRecordingError(f"found the pixels {list(self.pixels_sha256)}", "files inside the recording")

    def camera(self, camera_id: str) -> CameraFile:
        """Return the entry of one camera; raises BadRecordingError listing the known ones."""
        for camera in self.cameras:
            if camera.id == camera_id:
                return camera
        known = ", ".join(camera.id for camera in self.cameras)
        raise BadRecordingError(f"found no camera {camera_id} in the recording", f"one of {known}")


def dump_manifest(manifest: Manifest) -> str:
    """Return the manifest as JSON text."""
    version = COMPACT_VERSION if any(camera.compact for camera in manifest.cameras) else SCHEMA_VERSION
    document = {"schema_version": version, **dataclasses.asdict(manifest)}
    for table, camera in zip(document["cameras"], manifest.cameras, strict=True):
        if not camera.compact:
            del table["compact"]
        table.update(offered=camera.planes, written=camera.written, drops=camera.drops)
    return json.dumps(document, indent=1) + "\n"


def load_manifest(text: str | bytes) -> Manifest:
    """Read the text of `dump_manifest`; raises BadRecordingError for anything else."""
    try:
        document = json.loads(text)
        version = document.pop("schema_version")
        if version not in (SCHEMA_VERSION, COMPACT_VERSION):
            found = f"found schema {version!r}"
            expected = f"{SCHEMA_VERSION} or {COMPACT_VERSION}"
            raise BadRecordingError(found, expected, "update spike4dgs", where=MANIFEST_FILE)
        stated = [
            (typed(dict[str, int], table.pop("drops")), table.pop("offered", None), table.pop("written", None))
            for table in document["cameras"]
        ]
        manifest = typed(Manifest, document)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise BadRecordingError(f"found no manifest ({error})", "what spike4dgs writes", where=MANIFEST_FILE) from error
    for camera, (drops, offered, written) in zip(manifest.cameras, stated, strict=True):
        if drops != {layer: lost for layer, lost in camera.drops.items() if lost or layer in drops}:
            raise BadRecordingError(f"found the drops {drops}", f"{camera.drops} as the gaps say", where=camera.id)
        if (offered, written) not in ((None, None), (camera.planes, camera.written)):
            found = f"found {offered!r} planes offered, {written!r} written"
            raise BadRecordingError(found, f"{camera.planes} and {camera.written} as the gaps say", where=camera.id)
    return manifest


def typed(kind: Any, value: Any) -> Any:
    """Return a value out of JSON as `kind`: a dataclass, tuple, dict, Literal, `X | None` or plain type.

    Raises TypeError where it is of another type.
    """
    origin, parts = get_origin(kind), get_args(kind)
    if kind is Any or (value is None and type(None) in parts):
        return value
    if type(None) in parts:
        return typed(parts[0], value)
    if dataclasses.is_dataclass(kind):
        kinds = get_type_hints(kind)
        return kind(**{name: typed(kinds[name], part) for name, part in value.items()})  # type: ignore[operator]
    if origin is tuple and isinstance(value, list):
        kinds = [parts[0]] * len(value) if parts[-1] is Ellipsis else parts
        return tuple(typed(one, part) for one, part in zip(kinds, value, strict=True))
    if origin is dict and isinstance(value, dict):
        return {typed(parts[0], key): typed(parts[1], part) for key, part in value.items()}
    if value in parts or type(value) is kind or (kind is float and type(value) is int):
        return value
    raise TypeError(f"found {str(value)[:40]!r}, expected {kind}")
