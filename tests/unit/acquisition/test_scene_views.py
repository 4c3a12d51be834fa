"""Sources and truth take the frames of any renderer, not those of the ray caster alone."""

import json
from dataclasses import dataclass

import numpy as np

from acquisition.scenes.catalog import build_scene
from acquisition.scenes.source import SceneSource
from acquisition.scenes.truth import write_truth
from acquisition.scenes.view import Frames
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import unpack
from acquisition.spikes.sensor import Sensor
from rigs.toml import catalog_rig

RIG = catalog_rig("lab3x3").scaled(24, 15)


@dataclass(frozen=True)
class Dawn:
    """A scene that no ray caster draws: light that rises by `rate` spikes a tick each second, the same everywhere."""

    begins_s: float = 0.0
    name = "dawn"
    seed = 5
    white = 1.0
    center = (0.0, 0.0, 1.0)
    rate = 200.0

    def view(self, camera, samples, threads=0):
        return DawnView(self, (camera.height, camera.width))

    def since(self, begins_s):
        return Dawn(begins_s)

    def description(self):
        return {"object_ids": {"sky": 1}, "movers": []}


@dataclass(frozen=True)
class DawnView:
    scene: Dawn
    size: tuple[int, int]

    def light(self, instants_s):
        level = self.scene.rate * (np.asarray(instants_s) + self.scene.begins_s)
        return np.broadcast_to(level[:, None, None], (len(level), *self.size)).astype(np.float32)

    def frames(self, instants_s):
        light = self.light(instants_s)
        return Frames(light, np.full_like(light, 2.0), np.ones(light.shape, np.int8))


def test_a_simulated_camera_records_what_any_view_shows():
    camera, layout, ticks = RIG.camera("cam00"), PlaneLayout(24, 15), 100
    source = SceneSource(Dawn(), camera, RIG.clock, ticks, Sensor(24, 15, "ideal", 0, 0), layout)
    spikes = unpack(source.next_planes(ticks), layout).sum(axis=0)
    gathered = Dawn.rate * RIG.clock.tick_rate_hz**-1 * ticks**2 / 2
    assert np.abs(spikes - gathered).max() <= 1


def test_truth_holds_what_any_scenery_shows_and_says(tmp_path):
    write_truth(Dawn().since(0.001), RIG, 3, 2, tmp_path / "truth")
    expected = Dawn.rate * (2.5 / RIG.tick_rate_hz + 0.001)
    np.testing.assert_allclose(np.load(tmp_path / "truth/novel1/000002.npy"), expected, rtol=1e-6)
    np.testing.assert_allclose(np.load(tmp_path / "truth/cam22/blur_000002.npy"), expected, rtol=1e-6)
    said = json.loads((tmp_path / "truth/scene.json").read_text())
    assert (said["scene"], said["white"], said["object_ids"]) == ("dawn", 1.0, {"sky": 1})


def test_a_view_shows_the_scene_as_the_ray_caster_does():
    scene, camera = build_scene("fan_and_ball", 1), RIG.camera("cam11")
    instants_s = np.array([0.0, 0.004])
    light, frames = scene.view(camera, 4).light(instants_s), scene.render(camera, instants_s, 4)
    np.testing.assert_array_equal(light, frames.intensity)
    later = scene.since(0.004).view(camera, 4).light(np.zeros(1))
    np.testing.assert_array_equal(later[0], light[1])
