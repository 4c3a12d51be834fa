"""Gives a view of a simulated recording other images than its spikes make."""

from acquisition.recording.reader import Recording
from reconstruction.errors import BadRunError
from reconstruction.images.catalogue import GIVEN
from reconstruction.images.composite import CompositeSource, GivenSource
from reconstruction.truth import Truth


def given_source(view: str, source: CompositeSource, recording: Recording, images: str) -> GivenSource:
    """Return the same source with `images`, one of GIVEN, of a simulated recording.

    Raises BadRunError where there are none.
    """
    if recording.truth is None:
        raise BadRunError("found no truth", f"a simulated recording for the images `{images}`", where=recording.path)
    truth = Truth.open(recording.truth).within(recording.ticks)
    clean = lambda camera_id, plane: truth.frame(camera_id, plane).intensity  # noqa: E731
    kinds = (
        (truth.planes, clean, 1),
        (truth.planes, truth.blurred, truth.blur_ticks),
        (truth.frame_planes, truth.ordinary, truth.exposure_ticks),
    )
    instants, read, planes = kinds[GIVEN.index(images)]
    frames = {plane: source.carried(read(view, plane)) for plane in instants(view)}
    return GivenSource.of(source, frames, planes)
