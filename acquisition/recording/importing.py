"""Makes a recording of `.dat` files that another program wrote."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import BadRecordingError
from acquisition.progress import Progress, silent
from acquisition.recording.manifest import Manifest, block_planes_of
from acquisition.recording.stream_writer import StreamWriter
from acquisition.recording.writer import RecordingWriter
from acquisition.spikes.layout import BitOrder, PlaneLayout, RowOrder
from acquisition.spikes.stream import SpikeStream
from rigs.exchange.cameras import load_cameras
from rigs.rig import Poses, Rig
from rigs.toml import GRID_ID

_NAMED = re.compile(r"([A-Za-z0-9_-]+)=(.+)")


@dataclass(frozen=True)
class ImportOptions:
    """What a `.dat` does not say of itself.

    `size` (width, height) is needed where the cameras' file has none; `poses` None keeps a RIG.toml's own flag and
    means calibrated elsewhere; `allow_partial` drops what lies beyond the last whole plane, and the manifest says so.
    """

    tick_rate_hz: float
    size: tuple[int, int] | None = None
    poses: Poses | None = None
    bit_order: BitOrder = "lsb"
    row_order: RowOrder = "bottom"
    allow_partial: bool = False


def import_recording(
    dats: Sequence[str], cameras: Path, out: Path, options: ImportOptions, progress: Progress = silent
) -> Manifest:
    """Copy `dats` (`FILE` in the rig's order, or `camRC=FILE`) bit for bit into the recording `out`.

    Raises BadRecordingError or RigError naming the camera that does not fit; then nothing is left behind.
    """
    named = _named(dats)
    grid = named is None or all(GRID_ID.fullmatch(camera_id) for camera_id in named)
    ids = None if grid or named is None else list(named)
    rig = load_cameras(cameras, options.tick_rate_hz, size=options.size, ids=ids)
    if options.poses:
        rig = dataclasses.replace(rig, poses=options.poses)
    streams = {camera_id: _open(camera_id, path, rig, options) for camera_id, path in _match(dats, named, rig).items()}
    total = sum(stream.packed.nbytes for stream in streams.values())
    with RecordingWriter(out, rig, total) as recording:
        done, entries = 0, []
        for camera_id, stream in streams.items():
            progress(done / total, camera_id)
            writer = recording.stream(camera_id, stream.layout, len(stream))
            _copy(stream, writer)
            entries.append(writer.entry())
            done += stream.packed.nbytes
        manifest = recording.commit(entries, "import")
    progress(1.0, f"{len(streams)} cameras")
    return manifest


def _named(dats: Sequence[str]) -> dict[str, Path] | None:
    matches = [_NAMED.fullmatch(dat) for dat in dats]
    named = [(m[1], Path(m[2])) for m in matches if m]
    if not named:
        return None
    if len(named) < len(dats):
        plain = next(dat for dat, m in zip(dats, matches, strict=True) if not m)
        raise BadRecordingError(f"found {plain} among named files, expected camRC=FILE for all of them or for none")
    ids = [camera_id for camera_id, _ in named]
    repeated = sorted({camera_id for camera_id in ids if ids.count(camera_id) > 1})
    if repeated:
        raise BadRecordingError(f"found {', '.join(repeated)} more than once, expected one file a camera")
    return dict(named)


def _match(dats: Sequence[str], named: dict[str, Path] | None, rig: Rig) -> dict[str, Path]:
    """The file of each camera, in the rig's order."""
    files = named or dict(zip(rig.ids, map(Path, dats), strict=False))
    found = f"found {len(dats)} streams for {len(rig.ids)} cameras, expected one each"
    missing = [camera_id for camera_id in rig.ids if camera_id not in files]
    if missing:
        raise BadRecordingError(f"{found}; none for {', '.join(missing)}")
    surplus = [camera_id for camera_id in files if camera_id not in rig.ids] or list(dats[len(rig.ids) :])
    if surplus:
        raise BadRecordingError(f"{found}; no camera for {', '.join(surplus)}")
    return {camera_id: files[camera_id] for camera_id in rig.ids}


def _open(camera_id: str, path: Path, rig: Rig, options: ImportOptions) -> SpikeStream:
    camera = rig.camera(camera_id)
    layout = PlaneLayout(camera.width, camera.height, options.bit_order, options.row_order)
    try:
        return SpikeStream.open(path, layout, rig.tick_rate_hz, allow_partial=options.allow_partial)
    except BadRecordingError as error:
        raise BadRecordingError(f"{camera_id}: {error}") from error


def _copy(stream: SpikeStream, writer: StreamWriter) -> None:
    step = block_planes_of(stream.layout)
    try:
        for first in range(0, len(stream), step):
            writer.append(stream.window(first, min(first + step, len(stream))))
    finally:
        writer.close()
    writer.partial_bytes = stream.partial_bytes
