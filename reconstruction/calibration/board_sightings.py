"""Finds a calibration board in all cameras of a recording, at instants spread over it.

A board may be waved about: pictures are interpolated counts of 17 planes, which at an arm's speed blur no more than a
pixel or two, alike to both sides. While it stands still its pictures are one observation, with the noise averaged.
Letters: I instants, O observations.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquisition.progress import Progress, silent
from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.calibration.board_corners import Image, Sighting, find_board, find_tags
from reconstruction.calibration.board_spec import DICTIONARIES, BoardSpec, predefined
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.images.methods.interpolated import interpolated
from reconstruction.images.pixels import PixelCalibration, read_pixels
from rigs.transform import Floats

HALF_WINDOW = 8  # planes; more blur a waved board, fewer are noisier: 0.010 px for 8 and 16, 0.013 for 4 and 32
MOST_INSTANTS = 60
STILL_PX, ALIKE_PX = 0.15, 10.0  # largest move of a board that stands still, and of one seen in much the same way
LEAST_FITTING = 0.5  # least share of the tags seen that lie as the board says

Pictures = Mapping[tuple[int, str], Sighting]  # by number of the instant and camera id


@dataclass(frozen=True, eq=False)
class Sightings:
    """O observations: camera [O] and pose [O] by number, point [O] of the board, pixels [O, 2].

    `poses` is how many different poses of the board there are, out of `instants`.
    """

    poses: int
    instants: int
    camera: NDArray[np.int64]
    pose: NDArray[np.int64]
    point: NDArray[np.int64]
    pixels: Floats

    def __len__(self) -> int:
        return len(self.camera)

    def only(self, kept: NDArray[np.bool_]) -> Sightings:
        """Return the observations of the poses where `kept` [poses] is true, numbered anew."""
        these, number = kept[self.pose], np.cumsum(kept) - 1
        columns = (self.camera[these], number[self.pose[these]], self.point[these], self.pixels[these])
        return Sightings(int(kept.sum()), self.instants, *columns)

    def distinct(self) -> int:
        """Count the poses that differ by ALIKE_PX or more from the last one counted.

        What is left of a point's error beside noise comes of how pixels sample it, and is shared by poses nearly alike.
        """
        views = [self._view(pose) for pose in range(self.poses)]
        counted = views[:1]
        for view in views[1:]:
            common = [key for key in view if key in counted[-1]]
            shifts = [float(np.linalg.norm(view[key] - counted[-1][key])) for key in common]
            if not shifts or np.median(shifts) >= ALIKE_PX:
                counted.append(view)
        return len(counted)

    def _view(self, pose: int) -> dict[tuple[int, int], Floats]:
        """Return one pose's pixels by camera and point."""
        these = np.flatnonzero(self.pose == pose)
        return {(int(self.camera[i]), int(self.point[i])): self.pixels[i] for i in these}


def sight_board(recording: Recording, board: BoardSpec, progress: Progress = silent) -> Sightings:
    """Seek `board` in every camera of the recording.

    Raises BadRunError where another board is there or a camera's planes have another size than its rig says,
    GeometryError naming the cameras that do not see the board.
    """
    _refuse_other_sizes(recording)
    streams = {c: recording.stream(c) for c in recording.camera_ids}
    pixels = {c.id: read_pixels(c.pixels) if c.pixels else None for c in recording.rig.cameras}
    planes = chosen_planes(recording.planes, MOST_INSTANTS)
    found: dict[tuple[int, str], Sighting] = {}
    for number, plane in enumerate(planes):
        for camera_id, stream in streams.items():
            found[number, camera_id] = find_board(_picture(stream, plane, pixels[camera_id]), board)
        seen = sum(len(found[number, c].points) > 0 for c in streams)
        progress((number + 1) / len(planes), f"plane {plane}: board in {seen} of {len(streams)} cameras")
    _refuse_contradictions(board, found)
    if not any(len(sighting.points) for sighting in found.values()):
        middle = planes[len(planes) // 2]
        some = recording.camera_ids[:: max(1, len(streams) // 3)]
        _refuse_unseen(board, found, (_picture(streams[c], middle, pixels[c]) for c in some))
    blind = [c for c in streams if not any(len(found[n, c].points) for n in range(len(planes)))]
    if blind:
        advice = "hold the whole board where all cameras see it, nearer or in more light"
        found_none = f"found no board {board.text} in {', '.join(blind)}"
        raise GeometryError(found_none, "it in every camera at some instant", advice)
    return gathered(recording.camera_ids, found, len(planes))


def chosen_planes(planes: int, most: int) -> list[int]:
    """Return the middles of at most `most` windows that do not overlap, spread over all planes."""
    count = max(min(most, planes // (2 * HALF_WINDOW + 1)), 1)
    edges = np.linspace(0, planes, count + 1)
    return [int(plane) for plane in (edges[1:] + edges[:-1]) / 2]


def gathered(cameras: tuple[str, ...], found: Pictures, instants: int) -> Sightings:
    """Turn all pictures into observations; instants at which the board stood still are averaged to one pose."""
    groups: list[list[int]] = []
    for number in (n for n in range(instants) if any(len(found[n, c].points) for c in cameras)):
        if groups and _still(found, cameras, groups[-1][0], number):
            groups[-1].append(number)
        else:
            groups.append([number])
    rows = []
    for pose, group in enumerate(groups):
        for index, camera_id in enumerate(cameras):
            points, pixels = _averaged([found[number, camera_id] for number in group])
            rows.append((np.full(len(points), index), np.full(len(points), pose), points, pixels))
    columns = [np.concatenate(column) for column in zip(*rows, strict=True)]
    return Sightings(len(groups), sum(map(len, groups)), *columns)


def _still(found: Pictures, cameras: Iterable[str], one: int, other: int) -> bool:
    """Return whether the board stood in the same place, in every camera that sees it at both instants."""
    shifts = []
    for camera_id in cameras:
        a, b = found[one, camera_id], found[other, camera_id]
        _, at_a, at_b = np.intersect1d(a.points, b.points, return_indices=True)
        if len(at_a):
            shifts.append(float(np.median(np.linalg.norm(a.pixels[at_a] - b.pixels[at_b], axis=1))))
    return bool(shifts) and max(shifts) < STILL_PX


def _averaged(sightings: list[Sighting]) -> tuple[NDArray[np.int64], Floats]:
    """Return the points [n] that at least half of the sightings have, and their median pixels [n, 2]."""
    points = np.concatenate([s.points for s in sightings])
    pixels = np.concatenate([s.pixels for s in sightings])
    kept, counts = np.unique(points, return_counts=True)
    kept = kept[2 * counts >= len(sightings)]
    middle = np.median if len(sightings) > 2 else np.mean
    return kept, np.array([middle(pixels[points == point], axis=0) for point in kept]).reshape(-1, 2)


def _picture(stream: SpikeStream, plane: int, pixels: PixelCalibration | None) -> Image:
    image = interpolated(stream, plane, HALF_WINDOW).intensity
    return pixels.corrected(image) if pixels else image


def _refuse_other_sizes(recording: Recording) -> None:
    for camera in recording.rig.cameras:
        layout = recording.manifest.camera(camera.id).layout
        if (layout.width, layout.height) != (camera.width, camera.height):
            raise BadRunError(
                f"found planes of {layout.width}x{layout.height}",
                f"{camera.width}x{camera.height} as its rig says",
                "the rig file is another array's",
                where=f"{recording.path}: {camera.id}",
            )


def _refuse_contradictions(board: BoardSpec, found: Pictures) -> None:
    """Raise BadRunError where most tags that are seen are not on the board, or not where it has them."""
    seen = sum(len(sighting.tags) for sighting in found.values())
    fitting = sum(sighting.fitting for sighting in found.values())
    if fitting < LEAST_FITTING * seen:
        ids = sorted({tag for sighting in found.values() for tag in sighting.tags})
        raise BadRunError(
            f"found {fitting} of {seen} tags where the board has them, with ids {ids[0]} to {ids[-1]}",
            f"most of them, with ids 0 to {len(board.tags) - 1}",
            "it is another board: check columns, rows and millimetres",
            where=f"board {board.text}",
        )


def _refuse_unseen(board: BoardSpec, found: Pictures, pictures: Iterable[Image]) -> None:
    """Raise BadRunError or GeometryError, saying what is there in its stead."""
    if not any(sighting.tags for sighting in found.values()):
        other = _other_dictionary(list(pictures))
        if other:
            raise BadRunError(f"found tags of {other}", board.dictionary, "mend the SPEC", where=f"board {board.text}")
    advice = "hold it where the cameras see it whole, in focus and in the light"
    raise GeometryError(f"found no board {board.text} in any camera", do=advice)


def _other_dictionary(pictures: list[Image]) -> str:
    """Return the dictionary that most tags in the pictures belong to, if one picture has at least three of them."""
    best, most = "", 2
    for name in sorted(DICTIONARIES, key=lambda name: len(predefined(name).bytesList)):
        tags = max((len(find_tags(picture, name)[0]) for picture in pictures), default=0)
        if tags > most:
            best, most = name, tags
    return best
