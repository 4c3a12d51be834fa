"""`images`: spikes to pictures."""

from pathlib import Path
from typing import Any

import click
import numpy as np

from acquisition.arrays import write_array
from acquisition.errors import BadRecordingError
from acquisition.recording.reader import Recording
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.stream import SpikeStream
from acquisition.spikes.suspicion import suspected_bit_order
from reconstruction.images.catalogue import ImageMethod, method, names
from reconstruction.images.pixels import PixelCalibration, read_pixels
from reconstruction.report.display import grey
from reconstruction.report.pictures import write_png
from server.cli.options import PATH, parse_planes, parse_size
from server.cli.output import warn
from server.cli.progress import progress_of


@click.command("images")
@click.argument("source", metavar="SOURCE", type=PATH)
@click.option("--method", "name", required=True, help=f"One of: {', '.join(names())}.")
@click.option("--weights", type=PATH, help="Weights trained on your own recording, for a learned method.")
@click.option("--size", type=parse_size, metavar="WxH", help="WxH of a bare .dat.")
@click.option("--tick-rate", type=float, help="Planes a second of a bare .dat.")
@click.option("--ticks", type=parse_planes, metavar="A:B:STEP", help="Planes to make images at [default: every 20th].")
@click.option("--allow-partial", is_flag=True, help="Drop an incomplete last plane of a bare .dat.")
@click.option("--out", type=PATH, required=True, help="Folder for NNNNNN.npy, valid_NNNNNN.npy and NNNNNN.png.")
def images_command(source: Path, name: str, weights: Path | None, ticks: range | None, out: Path, **bare: Any) -> None:
    """Turn the spikes of SOURCE, a recording or a bare .dat file, into images: linear, in spikes per tick.

    A recording gets one folder a camera, and its pixels are evened out if its rig has their calibration.
    """
    estimate = method(name, weights)
    pixels: dict[str, PixelCalibration] = {}
    if source.is_dir():
        if given := [f"--{key.replace('_', '-')}" for key, value in bare.items() if value]:
            found, do = f"found {' and '.join(given)} for a recording", "leave them out"
            raise BadRecordingError(found, "none: its manifest says how it is", do, where=source)
        recording = Recording.open(source)
        streams = {camera_id: recording.stream(camera_id) for camera_id in recording.camera_ids}
        pixels = {camera.id: read_pixels(camera.pixels) for camera in recording.rig.cameras if camera.pixels}
    else:
        streams = {"": _bare_stream(source, **bare)}
    shortest = min(len(stream) for stream in streams.values())
    planes = ticks if ticks is not None else range(0, shortest, 20)
    if planes[-1] >= shortest:
        raise BadRecordingError(f"found the instant at plane {planes[-1]}", f"one inside 0:{shortest}")
    progress, done = progress_of("images"), 0
    for folder, stream in streams.items():
        (out / folder).mkdir(parents=True, exist_ok=True)
        for plane in planes:
            _write_image(out / folder, stream, plane, estimate, pixels.get(folder))
            done += 1
            progress(done / (len(streams) * len(planes)), f"{folder} plane {plane}".strip())
    click.echo(f"{done} images by {name} in {out}")


def _bare_stream(
    source: Path, size: tuple[int, int] | None, tick_rate: float | None, allow_partial: bool
) -> SpikeStream:
    if size is None or tick_rate is None:
        raise BadRecordingError("found a bare file", "its --size WxH and --tick-rate HZ beside it", where=source)
    stream = SpikeStream.open(source, PlaneLayout(*size), tick_rate, allow_partial=allow_partial)
    if doubt := suspected_bit_order(stream):
        warn(doubt)
    return stream


def _write_image(
    folder: Path, stream: SpikeStream, plane: int, estimate: ImageMethod, pixels: PixelCalibration | None
) -> None:
    image = estimate(stream, plane)
    intensity = pixels.corrected(image.intensity) if pixels else image.intensity.astype(np.float32)
    write_array(folder / f"{plane:06d}.npy", intensity)
    write_array(folder / f"valid_{plane:06d}.npy", image.valid & ~pixels.defect if pixels else image.valid)
    write_png(folder / f"{plane:06d}.png", grey(intensity, float(np.percentile(intensity, 99.9))))
