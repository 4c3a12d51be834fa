"""Writes changed copies of a recording: its rig as drawn, or fewer planes a second."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

from acquisition.recording.reader import Recording
from acquisition.recording.writer import RecordingWriter
from acquisition.scenes.misplaced import misplaced
from acquisition.spikes.stream import SpikeStream
from reconstruction.bench.paper.method import Change
from reconstruction.bench.poses import ERROR
from reconstruction.bench.streams import slowed
from rigs.rig import Rig


def changed(path: Path, out: Path, change: Change, seed: int) -> Path:
    """Return the recording in `path` after `change`: itself, or one in `out`, written where there is none yet.

    A changed recording has a truth only where its planes are those of the truth.
    """
    if change.every == 1 and not change.nominal:
        return path
    recording = Recording.open(path)
    if not out.exists():
        rig = misplaced(recording.rig, ERROR, seed) if change.nominal else recording.rig
        _write(recording, replace(rig, tick_rate_hz=rig.tick_rate_hz / change.every), change, out)
    truth = out / "truth"
    if change.every == 1 and recording.truth and not truth.is_symlink():
        truth.symlink_to(recording.truth.resolve())
    return out


def _write(recording: Recording, rig: Rig, change: Change, out: Path) -> None:
    streams = {c: _slower(recording.stream(c), change, n) for n, c in enumerate(recording.camera_ids)}
    total = sum(stream.packed.nbytes for stream in streams.values())
    with RecordingWriter(out, rig, total) as writer:
        for camera_id, stream in streams.items():
            with closing(writer.stream(camera_id, stream.layout, len(stream))) as file:
                file.append(stream.packed)
        writer.commit(writer.entries(), "import")


def _slower(stream: SpikeStream, change: Change, seed: int) -> SpikeStream:
    """Return the stream of one plane for `change.every`; `seed` draws what pixels have gathered before the first one.

    Where planes are dropped the middle one of each group is left, so that light is seen at the right time. An even
    group has no middle: its planes are half a plane late.
    """
    if change.every == 1:
        return stream
    if change.slowing == "drop":
        whole = len(stream) // change.every * change.every
        stream = SpikeStream(stream.packed[change.every // 2 : whole], stream.layout, stream.tick_rate_hz)
    return slowed(stream, change.every, change.slowing, seed)
