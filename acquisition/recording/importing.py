"""Makes a recording of `.dat` files that another program wrote."""

import dataclasses
import hashlib
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, part, silent
from acquisition.recording.flip import suspected_flip
from acquisition.recording.manifest import CameraFile, Conversion, Manifest, block_planes_of, note_bytes
from acquisition.recording.stream_writer import StreamWriter
from acquisition.recording.writer import MARGIN_BYTES, DiskUse, RecordingWriter
from acquisition.spikes import m1k40
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder
from acquisition.spikes.packing import counts
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.suspicion import middle_window, suspected_bit_order
from rigs.exchange.cameras import load_cameras
from rigs.rig import Poses, Rig
from rigs.toml import GRID_ID

SourceFormat = Literal["vidar", "vidar416", "m1k40"]
FORMATS: tuple[SourceFormat, ...] = get_args(SourceFormat)
TRAILING_COLUMNS = {"vidar": 0, "vidar416": 16}  # 400 pixels and 16 bits of a header in each stored row
_NAMED = re.compile(r"([A-Za-z0-9_-]+)=(.+)")


@dataclass(frozen=True)
class ImportOptions:
    """The facts that a `.dat` does not state itself.

    `size` (width, height) is needed where the cameras' file has none. With `poses` None a RIG.toml keeps its own flag
    and other poses count as calibrated. `allow_partial` drops the bytes beyond the last whole plane; the manifest says
    so. The `format` is `vidar` (rows of pixels alone), `vidar416` (16 bits behind each row) or `m1k40` (segments with
    trailers, which fix size and orders). Orders that are None are lsb and bottom. At least `keep_free_bytes`
    of the disk stay free.
    """

    tick_rate_hz: float
    size: tuple[int, int] | None = None
    poses: Poses | None = None
    bit_order: BitOrder | None = None
    row_order: RowOrder | None = None
    allow_partial: bool = False
    format: SourceFormat = "vidar"
    keep_free_bytes: int = MARGIN_BYTES

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise BadRecordingError(f"found the format {self.format!r}", f"one of {', '.join(FORMATS)}")
        if self.format == "m1k40" and (self.bit_order or self.row_order):
            raise BadRecordingError("found a bit or row order for m1k40", "none: the format fixes them")


Stream = SpikeStream | m1k40.M1K40Stream
Began = Mapping[str, tuple[float, float]]  # planes after any one camera's plane 0, and the standard deviation
Align = Callable[[Mapping[str, Stream]], Began]


def import_recording(
    dats: Sequence[str],
    cameras: Path,
    out: Path,
    options: ImportOptions,
    progress: Progress = silent,
    *,
    warn: Callable[[str], None] | None = None,
    align: Align | None = None,
) -> Manifest:
    """Copy `dats` (`FILE` in the rig's order, or `camRC=FILE`) into the recording `out`.

    Planes are kept bit for bit; those of M1K40 streams are decoded to plain ones, and the manifest says so. `warn` is
    called with a line for each doubt: a bit or row order that fits worse than the other, segments that are missing.
    `align` returns how many planes each camera began after one of them. What was sent before the last one began is then
    left out, so that planes of one number are of one instant to half a plane.
    Raises BadRecordingError or RigError naming the camera that does not fit; then nothing is left behind.
    """
    named = _named(dats)
    rig = _load_rig(cameras, options, named)
    streams = {camera_id: _open(camera_id, path, rig, options) for camera_id, path in _match(dats, named, rig).items()}
    if warn:
        for doubt in _doubts(rig, streams):
            warn(doubt)
    began = align(streams) if align else {}
    left = _left(began, rig.tick_rate_hz)
    streams = {camera_id: _since(camera_id, stream, began) for camera_id, stream in streams.items()}
    total = sum(len(stream) * stream.layout.plane_bytes for stream in streams.values())
    notes = sum(note_bytes(len(stream), stream.layout) for stream in streams.values())
    use = DiskUse(total + notes, max(options.keep_free_bytes, MARGIN_BYTES))
    with RecordingWriter(out, rig, use) as recording:
        done, entries = 0, []
        for camera_id, stream in streams.items():
            progress(done / total, camera_id)
            writer = recording.stream(camera_id, stream.layout, len(stream))
            size = len(stream) * writer.layout.plane_bytes
            _copy(stream, writer, part(progress, done / total, (done + size) / total))
            entries.append(dataclasses.replace(_entry(stream, writer), **left.get(camera_id, {})))
            done += size
        manifest = recording.commit(entries, "import")
    progress(1.0, f"{len(streams)} cameras")
    return manifest


def _load_rig(cameras: Path, options: ImportOptions, named: dict[str, Path] | None) -> Rig:
    """Return the cameras that the streams, `named` or in the rig's order, are of."""
    grid = named is None or all(GRID_ID.fullmatch(camera_id) for camera_id in named)
    ids = None if grid or named is None else list(named)
    size = (m1k40.SIDE, m1k40.SIDE) if options.format == "m1k40" and not options.size else options.size
    rig = load_cameras(cameras, options.tick_rate_hz, size=size, ids=ids)
    return dataclasses.replace(rig, poses=options.poses) if options.poses else rig


def first_planes(began: Began) -> dict[str, int]:
    """Return the first plane of each camera that is no earlier than the last one's plane 0, to half a plane."""
    last = max((planes for planes, _ in began.values()), default=0.0)
    return {camera_id: round(last - planes) for camera_id, (planes, _) in began.items()}


def _since(camera_id: str, stream: Stream, began: Began) -> Stream:
    """Return the part of `stream` that begins when the last camera began, all of it where that is not known."""
    first = first_planes(began).get(camera_id, 0)
    if first >= len(stream):
        found, do = f"found {len(stream)} planes, all sent before the last camera began", "import files of one instant"
        raise BadRecordingError(found, f"more than {first}", do, where=camera_id)
    return stream.since(first)


def _left(began: Began, tick_rate_hz: float) -> dict[str, dict[str, float]]:
    """Return by how much each camera's first plane is late against the last camera's, and the deviation, in seconds."""
    last, firsts = max((planes for planes, _ in began.values()), default=0.0), first_planes(began)
    return {
        camera_id: {
            "skew_s": (planes + firsts[camera_id] - last) / tick_rate_hz,
            "skew_sd_s": sd / tick_rate_hz,
        }
        for camera_id, (planes, sd) in began.items()
    }


def _named(dats: Sequence[str]) -> dict[str, Path] | None:
    matches = [_NAMED.fullmatch(dat) for dat in dats]
    named = [(m[1], Path(m[2])) for m in matches if m]
    if not named:
        return None
    if len(named) < len(dats):
        plain = next(dat for dat, m in zip(dats, matches, strict=True) if not m)
        raise BadRecordingError(f"found {plain} among named files", "camRC=FILE for all of them or for none")
    ids = [camera_id for camera_id, _ in named]
    repeated = sorted({camera_id for camera_id in ids if ids.count(camera_id) > 1})
    if repeated:
        raise BadRecordingError(f"found {', '.join(repeated)} more than once", "one file a camera")
    return dict(named)


def _match(dats: Sequence[str], named: dict[str, Path] | None, rig: Rig) -> dict[str, Path]:
    """Return the file of each camera, in the rig's order."""
    files = named or dict(zip(rig.ids, map(Path, dats), strict=False))
    missing = [camera_id for camera_id in rig.ids if camera_id not in files]
    surplus = [camera_id for camera_id in files if camera_id not in rig.ids] or list(dats[len(rig.ids) :])
    if missing or surplus:
        amiss = f"none for {', '.join(missing)}" if missing else f"no camera for {', '.join(surplus)}"
        raise BadRecordingError(f"found {len(dats)} streams for {len(rig.ids)} cameras", "one each", amiss)
    return {camera_id: files[camera_id] for camera_id in rig.ids}


def _open(camera_id: str, path: Path, rig: Rig, options: ImportOptions) -> Stream:
    camera = rig.camera(camera_id)
    with BadRecordingError.located(camera_id):
        if options.format == "m1k40":
            return _open_m1k40(path, (camera.width, camera.height), options.allow_partial)
        trailing = TRAILING_COLUMNS[options.format]
        orders = options.bit_order or "lsb", options.row_order or "bottom"
        layout = PlaneLayout(camera.width, camera.height, *orders, trailing)
        return SpikeStream.open(path, layout, rig.tick_rate_hz, allow_partial=options.allow_partial)


def _open_m1k40(path: Path, size: tuple[int, int], allow_partial: bool) -> m1k40.M1K40Stream:
    if size != (m1k40.SIDE, m1k40.SIDE):
        raise BadRecordingError(f"found a camera of {size[0]}x{size[1]}", f"{m1k40.SIDE}x{m1k40.SIDE} of an M1K40")
    with BadRecordingError.reading(path, "give an existing .dat"):
        data = np.memmap(path, dtype=np.uint8, mode="r") if path.stat().st_size else np.empty(0, dtype=np.uint8)
    with BadRecordingError.located(path):
        stream = m1k40.locate(data)
    if stream.partial_bytes and not allow_partial:
        found = f"found {stream.partial_bytes} bytes behind the last of {len(stream)} whole planes"
        raise BadRecordingError(found, "none", "allow a partial last plane", where=path)
    return stream


def _doubts(rig: Rig, streams: Mapping[str, Stream]) -> Iterator[str]:
    means = {}
    for camera_id, stream in streams.items():
        doubt = suspected_bit_order(stream) if isinstance(stream, SpikeStream) else _missing(stream)
        if doubt:
            yield f"{camera_id}: {doubt}"
        packed = middle_window(stream)
        means[camera_id] = counts(packed, stream.layout) / len(packed)
    if flip := suspected_flip(rig, means):
        yield flip


def _missing(stream: m1k40.M1K40Stream) -> str | None:
    if not stream.missing:
        return None
    some = ", ".join(map(str, list(stream.missing)[:5])) + ("..." if len(stream.missing) > 5 else "")
    return f"{sum(stream.missing.values())} segments are missing and will be zero, in the planes {some}"


def _copy(stream: Stream, writer: StreamWriter, progress: Progress) -> None:
    step = block_planes_of(writer.layout)
    try:
        for first in range(0, len(stream), step):
            writer.append(stream.window(first, min(first + step, len(stream))))
            progress(min(first + step, len(stream)) / len(stream), writer.camera_id)
    finally:
        writer.close()


def _entry(stream: Stream, writer: StreamWriter) -> CameraFile:
    entry = dataclasses.replace(writer.entry(), partial_bytes=stream.partial_bytes)
    if isinstance(stream, SpikeStream):
        return entry
    missing = tuple(stream.missing.items())
    conversion = Conversion("m1k40", hashlib.sha256(stream.data.data).hexdigest(), stream.skipped_bytes, missing)
    return dataclasses.replace(entry, conversion=conversion)
