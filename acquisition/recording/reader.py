"""A finished recording on disk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from acquisition.errors import BadRecordingError
from acquisition.recording.manifest import (
    MANIFEST_FILE,
    RIG_FILE,
    TRUTH_FOLDER,
    UNFINISHED,
    CameraFile,
    Manifest,
    load_manifest,
)
from acquisition.spikes.compact import CompactPlanes
from acquisition.spikes.stream import SpikeStream
from rigs.rig import Rig
from rigs.toml import load_rig


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording folder: its rig, its manifest and its streams. Build with `open`.

    `part_planes`: how many planes are at hand, from the tick at which the rig's clock begins; None for all of them.
    `becomes`: where a recording that is still written will lie when it is whole; None for a finished one.
    """

    path: Path
    rig: Rig
    manifest: Manifest
    part_planes: int | None = None
    becomes: Path | None = None

    def __post_init__(self) -> None:
        known = {camera.id for camera in self.manifest.cameras}
        missing = [camera_id for camera_id in self.rig.ids if camera_id not in known]
        if missing:
            found = f"found no stream of {', '.join(missing)}"
            raise BadRecordingError(found, "one for each camera of its rig", where=self.path)

    @classmethod
    def open(cls, path: Path) -> Recording:
        """Read manifest and rig; raises BadRecordingError when `path` is no recording. The planes are not touched."""
        return cls.of(path, read_manifest(path))

    @classmethod
    def of(cls, path: Path, manifest: Manifest, becomes: Path | None = None) -> Recording:
        """Return the recording of the folder `path` that `manifest` describes."""
        rig = replace(load_rig(path / RIG_FILE), first_tick=manifest.cameras[0].first_tick)
        return cls(path, rig, manifest, becomes=becomes)

    @property
    def tick_rate_hz(self) -> float:
        """Planes a second."""
        return self.manifest.tick_rate_hz

    @property
    def camera_ids(self) -> tuple[str, ...]:
        """The cameras in the rig's order."""
        return self.rig.ids

    @property
    def planes(self) -> int:
        """The number of planes at hand that every camera has."""
        if self.part_planes is not None:
            return self.part_planes
        return min(camera.planes for camera in self.manifest.cameras)

    @property
    def ticks(self) -> range:
        """The ticks of the planes at hand."""
        return range(self.rig.first_tick, self.rig.first_tick + self.planes)

    def part(self, from_tick: int | None, to_tick: int | None, cameras: Sequence[str] = ()) -> Recording:
        """Return the recording of the ticks [from_tick, to_tick) alone, None for an end of it, on the same clock.

        Each of `cameras` (none named: all) has all of its planes, also where some were cut off before others. Raises
        BadRecordingError for ticks that are reversed, or that it does not have.
        """
        entries = [self.manifest.camera(camera_id) for camera_id in cameras or self.camera_ids]
        if from_tick is to_tick is None and len({entry.planes for entry in self.manifest.cameras}) == 1:
            return self
        shortest = min(entries, key=lambda entry: entry.planes)
        if not shortest.planes:
            do = "leave it out by naming the others: --views, --holdout"
            raise BadRecordingError(f"found no plane of {shortest.id}", "at least one", do, where=self.path)
        planes = shortest.planes if self.part_planes is None else self.part_planes
        known = range(self.rig.first_tick, self.rig.first_tick + planes)
        ticks = ticks_between(known, from_tick, to_tick, self.path)
        return replace(self, rig=replace(self.rig, first_tick=ticks.start), part_planes=len(ticks))

    @property
    def truth(self) -> Path | None:
        """The folder with the ground truth of a simulated recording."""
        folder = self.path / TRUTH_FOLDER
        return folder if folder.is_dir() else None

    def stream(self, camera_id: str) -> SpikeStream:
        """Map the planes of one camera; raises BadRecordingError where the file is not what was recorded."""
        whole = self._stream(camera_id)
        if self.part_planes is None:
            return whole
        first = self.rig.first_tick - self.manifest.cameras[0].first_tick
        return whole.mapped(first, first + self.part_planes)

    def _stream(self, camera_id: str) -> SpikeStream:
        entry = self.manifest.camera(camera_id)
        is_there = bool(self.becomes) or (self.path / entry.stored_file).exists()
        if not is_there:  # it may have become compact since the manifest was read
            entry = read_manifest(self.path).camera(camera_id)
        if not entry.planes:
            do = "mend or leave it out, and record again"
            raise BadRecordingError(f"found no plane of {camera_id}", "at least one", do, where=self.path)
        if entry.compact:
            return SpikeStream(compact_planes(self.path, entry), entry.layout, self.tick_rate_hz)
        if self.becomes:
            return self._growing_stream(entry, self.becomes)
        stream = SpikeStream.open(self.path / entry.file, entry.layout, self.tick_rate_hz)
        if len(stream) != entry.planes:
            found, expected = f"found {len(stream)} planes", str(entry.planes)
            raise BadRecordingError(found, expected, "verify the recording", where=self.path / entry.file)
        return stream

    def _growing_stream(self, entry: CameraFile, becomes: Path) -> SpikeStream:
        """Map the planes that were known when a recording in the making was opened; it may have got its name since."""
        folder = self.path if (self.path / entry.file).exists() else becomes
        stream = SpikeStream.open(folder / entry.file, entry.layout, self.tick_rate_hz, allow_partial=True)
        return stream.mapped(0, entry.planes)


def ticks_between(known: range, from_tick: int | None, to_tick: int | None, where: Path | None = None) -> range:
    """Return the ticks [from_tick, to_tick), None for an end of those `known`.

    Raises BadRecordingError for none, for ticks that are reversed, or for some outside `known`.
    """
    first = known.start if from_tick is None else from_tick
    last = known.stop if to_tick is None else to_tick
    if not known.start <= first < last <= known.stop:
        expected = f"ticks from {known.start} to {known.stop}, the end excluded, and at least one"
        raise BadRecordingError(
            f"found the ticks {first} to {last}", expected, "change --from-tick or --to-tick", where=where
        )
    return range(first, last)


def compact_planes(folder: Path, camera: CameraFile) -> CompactPlanes:
    """Map the compact file of a camera of the recording in `folder`; raises BadRecordingError where it has none."""
    if not camera.compact:
        raise BadRecordingError(f"found {camera.file}", "a compact file", where=folder)
    shape = camera.planes, camera.layout.plane_bytes
    path = folder / camera.compact.file
    return CompactPlanes.open(path, shape, camera.compact.block_planes, camera.compact.block_bytes)


def read_manifest(path: Path) -> Manifest:
    """Read the manifest of the finished recording in `path`; raises BadRecordingError naming the folder."""
    manifest = read_any_manifest(path)
    if manifest.status in UNFINISHED:
        do = f"if nothing records it any more, run `spike4dgs finalise {path}`"
        raise BadRecordingError(f"found it {manifest.status}", "a finished recording", do, where=path)
    return manifest


def read_any_manifest(path: Path) -> Manifest:
    """Read the manifest in `path`, even of an unfinished recording; raises BadRecordingError naming the folder."""
    try:
        text = (path / MANIFEST_FILE).read_bytes()
    except OSError as error:
        found = f"found no readable {MANIFEST_FILE} ({error.strerror})"
        raise BadRecordingError(found, "a recording folder", where=path) from error
    with BadRecordingError.located(path):
        return load_manifest(text)
