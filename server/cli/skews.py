"""Tells when the cameras of a recording began, and how far apart their planes are."""

from collections.abc import Mapping

import click

from acquisition.recording.importing import Began, Stream, first_planes
from acquisition.recording.manifest import Manifest
from acquisition.session.alignment import align_by_light, firing_rate


def began_by_light(streams: Mapping[str, Stream]) -> Began:
    """Return how many planes after the first one each camera began, and print it with what is left out for that."""
    found = align_by_light({camera_id: firing_rate(stream) for camera_id, stream in streams.items()})
    firsts = first_planes(found)
    for camera_id, (planes, sd) in found.items():
        began = f"began {planes:+.2f} planes (sd {sd:.2f}) after {next(iter(found))}"
        click.echo(f"{camera_id}: {began}, its first {firsts[camera_id]} planes are left out", err=True)
    return found


def skew_doubt(manifest: Manifest) -> str | None:
    """Return what is to be said of planes of one number that are more than a plane apart, None where none are."""
    late = {
        camera.id: camera.skew_s * manifest.tick_rate_hz for camera in manifest.cameras if camera.skew_s is not None
    }
    if not late:
        return None
    first, last = min(late, key=lambda camera_id: late[camera_id]), max(late, key=lambda camera_id: late[camera_id])
    apart = round(late[last] - late[first], 2)
    if apart <= 1:
        return None
    return (
        f"planes of {last} come {apart:g} planes after those of {first} with the same number: they are not one instant"
    )
