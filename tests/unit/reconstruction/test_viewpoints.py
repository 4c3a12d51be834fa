"""Views nobody captured: where they stand, and what a cloud is scored by there."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.bench.conventions import KnownRecording
from reconstruction.bench.diagrams import plot_viewpoints
from reconstruction.bench.viewpoints import BEYOND_M, bench_viewpoints, viewpoints
from reconstruction.gaussians.cloud import GaussianCloud
from reconstruction.gaussians.dynamic import DynamicCloud
from reconstruction.gaussians.polynomial import PolynomialMotion
from reconstruction.scene_model import TimeSpan
from reconstruction.tensors import write_tensors
from rigs.toml import catalog_rig

VIEWS = ("cam00", "cam01", "cam02", "cam10", "cam12", "cam20", "cam21", "cam22")
CENTER = (0.0, 0.0, 1.8)


def by_line():
    found = {}
    for viewpoint in viewpoints(catalog_rig("lab3x3"), VIEWS, CENTER):
        found.setdefault(viewpoint.line, []).append(viewpoint)
    return found


def test_distances_are_from_the_nearest_camera_that_trained():
    lines = by_line()
    between = {round(v.along_m, 3): v.distance_m for v in lines["between"]}
    assert between[-0.2] == pytest.approx(0, abs=1e-9)
    assert between[0.0] == pytest.approx(0.2)  # the held-out centre
    assert between[0.1] == pytest.approx(0.1)
    assert [v.distance_m for v in lines["beyond"]] == pytest.approx(list(BEYOND_M))
    assert all(v.camera.center[2] > 0 for v in lines["forward"])
    assert all(v.camera.center[2] < 0 for v in lines["backward"])


def test_every_viewpoint_looks_at_the_centre_of_the_scene():
    for line in by_line().values():
        for viewpoint in line:
            x, y, z = viewpoint.camera.cam_from_rig.apply(np.array(CENTER))
            assert (x, y) == pytest.approx((0, 0), abs=1e-9)
            assert z > 0


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """A recording, and a run whose cloud is a grey wall."""
    folder = tmp_path_factory.mktemp("viewpoints")
    simulate(Simulation("fan_and_ball", seed=1), catalog_rig("ci3x3"), 40, folder / "rec")
    x, y = (a.ravel() for a in torch.meshgrid(*[torch.linspace(-1.5, 1.5, 25)] * 2, indexing="ij"))
    n = len(x)
    wall = GaussianCloud(
        torch.stack([x, y, torch.full((n,), 2.2)], dim=1),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(n, 1),
        torch.full((n, 3), -2.5),
        torch.full((n,), 4.0),
        torch.full((n, 1), 0.2),
    )
    none = GaussianCloud(*(tensor[:0] for tensor in vars(wall).values()))
    cloud = DynamicCloud(wall, none, PolynomialMotion.at_rest(torch.zeros(0), 1.0), TimeSpan(0.0, 0.002))
    write_tensors(folder / "last.pt", {"cloud": cloud.state()})
    run = SimpleNamespace(
        snapshots=lambda: [folder / "last.pt"],
        plan=SimpleNamespace(views=VIEWS),
        document=SimpleNamespace(seconds={"train": 1.5}),
    )
    runs = [(KnownRecording("fan_and_ball", 1, folder / "rec"), run)]
    return runs, bench_viewpoints(runs, silent).to_json()


def test_a_wall_is_scored_everywhere(bench):
    _, document = bench
    assert {row["line"] for row in document["rows"]} == {"between", "beyond", "forward", "backward"}
    assert all(5 < row["psnr_db"] < 30 and 0 <= row["empty"] <= 1 for row in document["rows"])
    near, far = (document["summary"][f"beyond+{cm}cm.empty"] for cm in (5, 120))
    assert far > near  # the wall ends
    json.dumps(document, allow_nan=False)


def test_the_picture_is_drawn(bench, tmp_path):
    _, document = bench
    plot_viewpoints(tmp_path / "plot.png", document)
    assert (tmp_path / "plot.png").stat().st_size > 1000
