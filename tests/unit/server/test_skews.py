from dataclasses import replace

from acquisition.recording.manifest import CameraFile, Manifest
from acquisition.spikes.layout import PlaneLayout
from server.cli.skews import skew_doubt


def recorded(**skews_s: float | None) -> Manifest:
    entry = CameraFile("cam00", "cam00.dat", PlaneLayout(8, 8), 0, 0, 80, (), None)
    cameras = (replace(entry, id=name, file=f"{name}.dat", skew_s=skew_s) for name, skew_s in skews_s.items())
    return Manifest(20_000.0, "box", "spike4dgs", "", tuple(cameras))


def test_planes_more_than_one_apart_are_told_and_others_are_not() -> None:
    found = skew_doubt(recorded(cam00=-0.5e-3, cam01=0.0, cam02=2.53e-3, cam10=None))
    assert found is not None
    assert found.startswith("planes of cam02 come 60.6 planes after those of cam00 with the same number")
    for quiet in (recorded(cam00=-25e-6, cam01=25e-6), recorded(cam00=None, cam01=None), recorded(cam00=1.0)):
        assert skew_doubt(quiet) is None
