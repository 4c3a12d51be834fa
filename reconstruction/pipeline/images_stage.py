"""Finds how the pixels of every training view answer light, and its background: what stays without the movers."""

import numpy as np

from acquisition.progress import Progress
from acquisition.recording.reader import Recording
from acquisition.spikes.stream import SpikeStream
from reconstruction.errors import BadRunError
from reconstruction.images.background import Background, background
from reconstruction.images.failures import failing_pixels
from reconstruction.images.flicker import Light
from reconstruction.images.mending import mended
from reconstruction.images.pixels import read_pixels
from reconstruction.images.response import NEVER, Response
from reconstruction.images.standing import standing
from reconstruction.parallel import each
from reconstruction.pipeline.artefacts import BACKGROUND, MOVING, read_light, write, write_responses
from reconstruction.pipeline.span_artefacts import BLIND, MASKS, PLANNED, parts_to_learn, read_masks, write_masks
from reconstruction.run.configuration import MAPS
from reconstruction.run.decisions import Decision
from reconstruction.run.folder import RunFolder
from reconstruction.run.parts import PartFolder
from reconstruction.run.plan import DARK_RATE
from rigs.camera import Camera

DARK_GAIN = 0.05  # share of the usual light below which a span shows nothing


def images_stage(run: RunFolder, recording: Recording, progress: Progress) -> None:
    """Find and keep the response and the background of every training view."""
    views, light, calibrated = run.plan.views, read_light(run), run.plan.pixels == MAPS

    def look(view: str) -> tuple[Response | None, int, int]:
        stream = recording.stream(view)
        response, failing = _response(recording.rig.camera(view), stream, light, calibrated=calibrated)
        if run.plan.spans:
            found = _standing(run, view, stream, light, response)
        else:
            found = background(stream, run.read_array(MOVING.format(view=view)), light, response)
        write(run, BACKGROUND, found, view)
        return response, failing, int(found.stuck.sum())

    responses, failed = {}, 0
    for i, (view, (response, failing, stuck)) in enumerate(zip(views, each(look, views), strict=True)):
        if response is not None:
            responses[view] = response
        failed += failing
        progress((i + 1) / len(views), f"background of {view}, {stuck} stuck pixels")
    write_responses(run, responses)
    PartFolder(run.path).note(parts_to_learn(run) if run.plan.spans else [])
    if failed:
        reason = "lone pixels that jump, and from then on see nothing change; no image or count reads them after that"
        run.amend("images", Decision("failing pixels", f"{failed} left out once they fail", reason, "none"))


def _standing(run: RunFolder, view: str, stream: SpikeStream, light: Light, response: Response | None) -> Background:
    """Return what stands still in a view over all spans, and keep what each span shows otherwise."""
    spans, size = run.plan.spans, (stream.layout.height, stream.layout.width)
    planned = read_masks(run, PLANNED, view, size)
    usual = background(stream, np.logical_or.reduce(planned), light, response)
    rates = stream.window_counts([(span.first, span.last) for span in spans]).astype(np.float32)
    blind = np.zeros(len(spans), bool)
    for number, (rate, span) in enumerate(zip(rates, spans, strict=True)):
        gain = light.over(span.first, span.last)
        blind[number] = gain < DARK_GAIN or rate.mean() < DARK_RATE * len(span)
        rate /= np.float32(len(span) * max(gain, DARK_GAIN))
        rate[:] = mended(response.light(rate) if response else rate, usual.stuck)
    found = standing(rates, planned | blind[:, None, None], usual, [len(span) for span in spans])
    write_masks(run, MASKS, view, (planned | found.differs) & ~blind[:, None, None])
    run.write_array(BLIND.format(view=view), blind)
    run.write_array(MOVING.format(view=view), ~found.background.trusted)
    return found.background


def _response(camera: Camera, stream: SpikeStream, light: Light, *, calibrated: bool) -> tuple[Response | None, int]:
    """Return how the pixels of a view answer light, None where they are all alike and good, and how many fail."""
    response = None
    if calibrated and camera.pixels is not None:
        maps, size = read_pixels(camera.pixels), (camera.height, camera.width)
        if maps.gain.shape != size:
            found = f"found pixel maps of {maps.gain.shape[::-1]}"
            raise BadRunError(found, f"{size[::-1]}, as the camera has", "calibrate again", where=camera.pixels)
        response = Response.calibrated(maps)
    fails = failing_pixels(stream, light)
    if response is not None:
        fails[response.useless(1)] = NEVER
    failing = int(np.count_nonzero(fails != NEVER))
    if failing:
        response = (response or Response.even(fails.shape)).failing(fails)
    return response, failing
