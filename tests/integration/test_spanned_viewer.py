"""The viewer of a recording that was learnt in spans, in a real browser: it fetches what it shows, and keeps little."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from integration.viewer_page import (
    VIEWER,
    app_of,
    chromium,
    drawn_pixels,
    opening,
    pixels,
    put,
    seek,
    served,
    settle,
    until,
)

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.gaussians.spanned import SpannedScene
from reconstruction.pipeline.stages import reconstruct
from reconstruction.rendering.render import render
from reconstruction.report.display import grey
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.spans import LEAST
from reconstruction.training.checkpoint import load_cloud
from rigs.camera import Camera
from rigs.toml import catalog_rig
from rigs.transform import Transform

pytestmark = VIEWER
SPANS, PLANES = 5, 60  # the planes are those of a span
GAP = 2
CONFIG = ReconstructionConfig(holdout="cam11", steps=12, budget_s=None, seed=1, gaussians=600, span=LEAST)
KEPT = "document.getElementById('picture').dataset.kept.split(',')"


@dataclass
class Long:
    """A run of `SPANS` spans: its scene, and the document and folder of its viewer."""

    cloud: SpannedScene
    document: dict[str, Any]
    jobs: Path

    def range_of(self, number: int) -> str:
        span = self.document["spans"][number]
        return f"bytes={span['offset']}-{span['offset'] + span['length'] - 1}"

    @property
    def still(self) -> str:
        return f"bytes=0-{self.document['spans'][0]['offset'] - 1}"


def with_a_gap(document: dict[str, Any]) -> dict[str, Any]:
    """The document of a recording in whose third span nothing differs from the still scene."""
    spans = [*document["spans"]]
    moving = document["moving"] - spans[GAP]["moving"]
    nothing = {"length": 0, "changed": 0, "moving": 0, "motion": "static", "keyframes": 0, "arrays": {}}
    spans[GAP] = spans[GAP] | nothing
    return document | {"spans": spans, "moving": moving, "count": document["still"] + moving}


@pytest.fixture(scope="module")
def long(tmp_path_factory: pytest.TempPathFactory) -> Long:
    folder = tmp_path_factory.mktemp("long")
    rig = catalog_rig("ci3x3").scaled(64, 40)
    simulate(Simulation("fan_and_ball", seed=3), rig, SPANS * PLANES, folder / "rec")
    run = reconstruct(folder / "rec", folder / "run", CONFIG, lambda stage: silent)
    job = folder / "jobs" / "long"
    job.mkdir(parents=True)
    for name in ("viewer.json", "viewer.bin"):
        shutil.copy(run.path / name, job)
    document = json.loads((job / "viewer.json").read_text())
    for name, made in (("gap", with_a_gap(document)), ("odd", document | {"moving": 1})):
        shutil.copytree(job, job.with_name(name))
        (job.with_name(name) / "viewer.json").write_text(json.dumps(made))
    cloud = load_cloud(run.checkpoint)
    assert isinstance(cloud, SpannedScene)
    return Long(cloud, document, job.parent)


@pytest.fixture(scope="module")
def address(long: Long) -> Iterator[str]:
    with served(app_of(long.jobs)) as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as running:
        yield running


@pytest.fixture
def open_page(browser: Any, address: str) -> Iterator[Callable[..., Any]]:
    with opening(browser, address) as found:
        yield found


@pytest.fixture
def opened(open_page) -> tuple[Any, list[str | None]]:
    """The viewer of the run, and the ranges that it asks for from the beginning."""
    view, asked = open_page("?job=none", width=600, height=560), []
    view.locator("#message[role=alert]").wait_for()
    open_page.faults.clear()  # there is no such job
    view.on("request", lambda one: asked.append(one.headers.get("range")) if "viewer.bin" in one.url else None)
    view.goto(view.url.replace("none", "long"))
    settle(view)
    return view, asked


def middle(number: int) -> float:
    """The middle of a span, in parts of the recording."""
    return (number + 0.5) / SPANS


def test_a_seek_fetches_one_span_and_shows_another_picture(opened, long: Long) -> None:
    view, asked = opened
    assert asked == [long.still, long.range_of(0)]
    words = view.inner_text("#what")
    assert f"{long.document['count']:,} Gaussians, {long.document['moving']} of them moving, in {SPANS} spans" in words
    first = pixels(view)
    seek(view, middle(3))
    assert asked[2:] == [long.range_of(3)]
    assert view.inner_text("#instant") == "10.50 of 15.00 ms"
    assert np.abs(pixels(view).astype(int) - first).mean() > 0.5
    seek(view, middle(3) + 0.02)  # the same span
    assert len(asked) == 3
    seek(view, 0)
    np.testing.assert_array_equal(pixels(view), first)  # what another span changed of the still ones is undone
    assert asked[3:] == [long.range_of(0)]
    assert view.evaluate(KEPT) == ["0"]


@pytest.mark.parametrize("number", [1, 4])
def test_a_span_is_drawn_as_the_run_renders_it(opened, long: Long, number: int) -> None:
    view, _ = opened
    seek(view, middle(number))
    entry = next(camera for camera in long.document["cameras"] if camera["held_out"])
    width, height = view.eval_on_selector("#picture", "canvas => [canvas.width, canvas.height]")
    scale = min(width / entry["width"], height / entry["height"])
    left, top = (width - scale * entry["width"]) / 2, (height - scale * entry["height"]) / 2
    lens = (scale * entry["fx"], scale * entry["fy"], left + scale * entry["cx"], top + scale * entry["cy"])
    pose = np.reshape(entry["cam_from_rig"], (4, 4))
    camera = Camera("shown", width, height, *lens, Transform(pose[:3, :3], pose[:3, 3]))
    first_s, last_s = long.document["clip_s"]
    with torch.no_grad():
        own = render(long.cloud.at(first_s + middle(number) * (last_s - first_s)), camera).intensity[..., 0].numpy()
    off = np.abs(pixels(view)[..., 0].astype(int) - grey(own, long.document["white"]))
    assert off.mean() < 0.15  # measured .06 and .09
    assert np.percentile(off, 99) <= 3  # measured 1 and 2


def test_playing_fetches_each_span_once_and_keeps_three_at_most(opened, long: Long) -> None:
    view, asked = opened
    view.select_option("#speed", "4")
    kept = set()
    view.click("#play")
    for _ in range(2000):
        kept.add(len(view.evaluate(KEPT)))
        if float(view.input_value("#time")) > middle(SPANS - 1):
            break
        view.wait_for_timeout(20)
    view.click("#play")
    settle(view)
    assert asked[:6] == [long.still, *(long.range_of(number) for number in range(SPANS))]
    assert asked[6:] == [long.range_of(number % SPANS) for number in range(len(asked) - 6)]  # a pass begins again
    assert max(kept) <= 3


def test_what_cannot_be_had_is_said_and_tried_again_on_play(open_page, opened, long: Long) -> None:
    view, asked = opened
    held: list[Any] = []
    before = pixels(view)
    view.route("**/viewer.bin", lambda route: held.append(route))
    put(view, middle(2))
    until(view, "document.getElementById('awaited').textContent.startsWith('Loading')")
    np.testing.assert_array_equal(drawn_pixels(view), before)
    assert view.is_disabled("#save")
    while not held:
        view.wait_for_timeout(20)
    held.pop().abort()
    until(view, "document.getElementById('told').textContent !== ''")
    assert view.inner_text("#told") == (
        "6.00 to 9.00 ms cannot be shown. The service does not answer; check that it runs. Play on to try again."
    )
    assert view.inner_text("#awaited") == ""
    assert len(asked) == 3
    np.testing.assert_array_equal(drawn_pixels(view), before)
    view.unroute("**/viewer.bin")
    view.click("#play")
    until(view, "document.getElementById('told').textContent === ''")
    until(view, f"{KEPT}.includes('2')")
    view.click("#play")
    settle(view)
    assert asked[3] == long.range_of(2)
    assert np.abs(pixels(view).astype(int) - before).mean() > 0.5
    open_page.faults[:] = [fault for fault in open_page.faults if "ERR_FAILED" not in fault]


def test_a_link_opens_at_its_span_alone(opened, open_page, long: Long) -> None:
    view, _ = opened
    other, asked = open_page("?job=long&at=link#instant_s=0.0105&speed=4", width=600, height=560), []
    settle(other)  # what the first opening asks for is not counted
    other.on("request", lambda one: asked.append(one.headers.get("range")) if "viewer.bin" in one.url else None)
    other.reload()
    settle(other)
    assert asked == [long.still, long.range_of(3)]
    assert other.inner_text("#instant") == "10.50 of 15.00 ms"
    seek(view, middle(3))
    np.testing.assert_array_equal(pixels(other), pixels(view))


def test_a_span_of_nothing_is_not_asked_for(open_page) -> None:
    view, asked = open_page("?job=gap", width=600, height=560), []
    settle(view)
    view.on("request", lambda one: asked.append(one.headers.get("range")) if "viewer.bin" in one.url else None)
    seen = [pixels(view)]
    for number in (GAP, 3):
        seek(view, middle(number))
        seen.append(pixels(view))
    assert len(asked) == 1
    assert all(np.abs(one.astype(int) - other).mean() > 0.5 for one, other in pairwise(seen))


def test_spans_that_do_not_add_up_are_refused_in_a_line(open_page) -> None:
    view = open_page("?job=odd")
    view.locator("#message[role=alert]").wait_for()
    words = "viewer.json: found 1 moving Gaussians, expected as many as in all spans; export the job again"
    assert view.inner_text("#message") == words


def test_a_scene_that_was_made_anew_meanwhile_is_not_mixed_with_the_old_one(open_page, long: Long) -> None:
    view = open_page("?job=gap", width=600, height=560)
    settle(view)
    file = long.jobs / "gap" / "viewer.bin"
    file.write_bytes(file.read_bytes() + b"more")
    put(view, middle(4))
    until(view, "document.getElementById('told').textContent !== ''")
    words = "12.00 to 15.00 ms cannot be shown. viewer.bin: found another one than before; reload."
    assert view.inner_text("#told") == words
