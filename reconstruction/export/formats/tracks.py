"""`tracks.csv`: where each rigid body is and how it is turned, at even instants.

A line is `track,instant_s,x_m,y_m,z_m,qw,qx,qy,qz`: a body's number, an instant of the rig clock, the place of its
middle and its turn in the rig frame. A track ends where its body is not found again. What bends, or flies in pieces,
has none.
"""

import csv
import io
from pathlib import Path

from acquisition.durable import write_durably
from acquisition.progress import Progress
from reconstruction.errors import BadRunError
from reconstruction.export.scene import TICKS, Choices, Format, Scene

HEAD = ("track", "instant_s", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


def write_tracks(path: Path, scene: Scene, choices: Choices, progress: Progress) -> dict:
    """Write the table; raises BadRunError for a model without rigid bodies."""
    from reconstruction.gaussians.dynamic import DynamicCloud
    from reconstruction.gaussians.rigid import RigidMotion
    from reconstruction.gaussians.spanned import SpannedScene
    from reconstruction.gaussians.tracks import tracks_of
    from rigs.rig import object_distance_m

    cloud = scene.cloud
    is_free = isinstance(cloud, DynamicCloud) and len(cloud.moving) > 0 and not isinstance(cloud.motion, RigidMotion)
    if is_free or not isinstance(cloud, DynamicCloud | SpannedScene):
        raise BadRunError(f"found the model {scene.model}", "one with rigid bodies", "reconstruct with --model bases")
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(HEAD)
    tracks = tracks_of(cloud, object_distance_m(scene.rig.cameras))
    for _, instant_s in scene.frames(choices, progress):
        for track in tracks:
            leg = track.at(instant_s)
            if leg is not None:
                (quat,), (place,) = (pose.tolist() for pose in leg.pose(instant_s))
                table.writerow([track.number, f"{instant_s:.9g}", *(f"{value:.6g}" for value in (*place, *quat))])
    write_durably(path, text.getvalue())
    return {"tracks": len(tracks)}


TRACKS = Format(
    "tracks", "places and turns of rigid bodies over the clip", "tracks.csv", write_tracks, ("frames", *TICKS)
)
