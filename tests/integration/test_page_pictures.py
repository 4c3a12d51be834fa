"""Pictures on the operator's page opened large, in a real browser before a service of fake_stage.py."""

import re
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from maintenance.operator_page import BROWSER, CONTRAST, Seen, Service, drawn, expect
from maintenance.waiting import wait_for

from server.schemas.calibrations import CalibrationRequest
from server.schemas.captures import Capture
from server.schemas.job_types import ReconstructRequest

pytestmark = BROWSER
LOADED = "() => [...document.querySelectorAll('#cells img')].filter((one) => one.naturalWidth > 100).length === 9"
SMALLEST = """() => Math.min(...[...document.querySelectorAll('#large *')].filter((one) => one.checkVisibility()
  && [...one.childNodes].some((node) => node.nodeType === 3 && node.data.trim())).map((one) =>
  parseFloat(getComputedStyle(one).fontSize)))"""
PLOT = cv2.imencode(".png", np.full((1100, 1120), 255, np.uint8))[1].tobytes()


@pytest.fixture(scope="module")
def looked(service: Service) -> Service:
    """A service whose rig has been looked at."""
    job = service.client.look("lab3x3")
    service.wait(job.id, "done")
    return service


def large(page: Any, selector: str) -> None:
    """Open a picture of cameras large by its link, and wait for all of them."""
    drawn(page, f"{selector} img")
    page.locator(f"{selector} a.open-large").first.click()
    page.wait_for_function(LOADED)


def test_a_look_opens_large_by_keys_and_goes_back_step_by_step(
    looked: Service, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    drawn(page, "#rig-lab3x3 figure img")
    opener = page.locator("#rig-lab3x3 figure a.open-large")
    opener.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#large-title")).to_have_text("What the cameras of lab3x3 see")
    page.wait_for_function(LOADED)
    assert page.evaluate("(d => [d.clientWidth, d.clientHeight])(document.querySelector('#large'))") == [1280, 900]
    boxes = [page.locator(f"#cell-cam{n // 3}{n % 3}").bounding_box() for n in range(9)]
    columns, rows = ({round(box[side]) for box in boxes} for side in ("x", "y"))
    assert (len(columns), len(rows)) == (3, 3)
    assert all(boxes[n]["y"] + boxes[n]["height"] <= boxes[n + 3]["y"] for n in range(6))
    expect(page.locator("#cell-cam00")).to_be_focused()
    page.keyboard.press("ArrowDown")
    expect(page.locator("#cell-cam10")).to_be_focused()
    page.keyboard.press("6")
    expect(page.locator(".cell:visible")).to_have_count(1)
    expect(page.locator("#cell-cam12")).to_be_focused()
    assert page.locator("#cell-cam12 img").bounding_box()["width"] > 900
    page.keyboard.press("ArrowRight")
    expect(page.locator("#cell-cam20")).to_be_visible()
    page.keyboard.press("ArrowUp")
    expect(page.locator("#cell-cam10")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator(".cell:visible")).to_have_count(9)
    expect(page.locator("#cell-cam10")).to_be_focused()
    page.locator("#cell-cam22").click()
    expect(page.locator(".cell:visible")).to_have_count(1)
    page.click("#large-back")
    expect(page.locator(".cell:visible")).to_have_count(9)
    page.keyboard.press("Escape")
    expect(page.locator("#large")).to_have_count(0)
    expect(opener).to_be_focused()
    assert seen.faults == []


def test_a_capture_shows_the_light_of_each_camera(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    large(page, f"#capture-{capture.id}")
    figures = service.client.figures(capture.id).cameras
    assert [one.under for one in figures] == [n / 10 for n in range(9)]  # as fake_results.py lights them
    for n, one in enumerate(figures):
        expect(page.locator(f"#cell-{one.id}")).to_contain_text(f"Under {10 * n}.0 %")
    expect(page.locator("#cell-cam21 .failed")).to_have_text("Under 70.0 %")
    page.keyboard.press("5")
    expect(page.locator("#cell-cam11 .more").first).to_contain_text("Mean light 0.300 spikes per tick, from 40 planes")
    assert page.locator("#cell-cam11 .histogram rect").count() == 32
    assert page.locator("#large-live, #large-forget").count() == 0
    assert seen.faults == []


def test_the_large_view_follows_each_look_and_keeps_the_best_focus(
    looked: Service, open_page: Callable[..., Any], seen: Seen
) -> None:
    number, fetched = [0], set()
    focus = [4.0, 8.0, 6.0, 6.0]

    def status(route: Any) -> None:
        found = route.fetch().json()
        found["look"]["etag"] = f'"look-{number[0]}"'
        route.fulfill(json=found)

    def figures(route: Any) -> None:
        found = route.fetch().json() | {"etag": f'"look-{number[0]}"'}
        found["cameras"][4]["focus"] = focus[number[0]]
        fetched.add(number[0])
        route.fulfill(json=found)

    def taken(route: Any) -> None:
        if route.request.method == "POST":
            if number[0] in fetched:  # a busy machine asks for the next look before it has fetched the last one
                number[0] = min(3, number[0] + 1)
            return route.fulfill(json={"id": "j20260101-000000-00000000"})
        return figures(route)

    def prepare(page: Any) -> None:
        page.route("**/v1/rigs/lab3x3/status", status)
        page.route("**/v1/rigs/lab3x3/look", taken)
        page.route("**/v1/jobs/j20260101*", lambda route: route.fulfill(json={"status": "done"}))

    page = open_page(prepare=prepare)
    large(page, "#rig-lab3x3 figure")
    page.keyboard.press("5")
    cell = page.locator("#cell-cam11")
    expect(cell.locator(".focus")).to_have_text("Focus 4.00")
    expect(cell).to_contain_text("100 % of the best")
    page.locator("#large-live").check()
    expect(cell.locator(".focus")).to_have_text("Focus 6.00")
    expect(cell).to_contain_text("75 % of the best")
    assert cell.locator("meter").evaluate("one => [one.value, one.max]") == [6, 8]
    expect(cell.locator("img")).to_have_attribute("src", re.compile("look-3"))
    expect(cell).to_be_visible()
    page.locator("#large-live").uncheck()
    assert page.locator("#live-lab3x3").is_checked() is False
    page.click("#large-forget")
    expect(cell).to_contain_text("100 % of the best")
    assert seen.faults == []


def test_a_residual_picture_can_be_read_on_a_telephone(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen
) -> None:
    def prepare(page: Any) -> None:
        page.route("**/calibrations/*/picture", lambda route: route.fulfill(content_type="image/png", body=PLOT))

    service.client.calibrate("lab3x3", CalibrationRequest(capture=capture.id))
    wait_for(lambda: service.client.current_calibration("lab3x3").version > 0)
    page = open_page(400, prepare=prepare)
    page.click("#calibrations-lab3x3 summary")
    drawn(page, "#calibrations-lab3x3 img")
    page.click("#calibrations-lab3x3 a.open-large")
    picture, pane = page.locator("#large-picture"), page.locator("#large-pane")
    wait_for(lambda: picture.evaluate("one => one.clientWidth") == 1120)  # its own size, though the window is small
    assert pane.evaluate("one => one.scrollWidth > one.clientWidth && one.clientWidth <= 400")
    page.keyboard.press("ArrowRight")
    wait_for(lambda: pane.evaluate("one => one.scrollLeft") > 0)
    page.click("#large-fit")
    assert picture.evaluate("one => one.clientWidth") <= 400
    expect(page.locator("#large-smaller")).to_be_disabled()
    page.keyboard.press("+")
    assert 400 < picture.evaluate("one => one.clientWidth") < 700
    assert page.evaluate("document.documentElement.scrollWidth") == 400
    page.keyboard.press("Escape")
    expect(page.locator("#large")).to_have_count(0)
    assert seen.faults == []


def test_a_jobs_pictures_are_leafed_through(done: str, open_page: Callable[..., Any], seen: Seen) -> None:
    page = open_page()
    drawn(page, f"#job-{done} .outcome img")
    page.click(f"#job-{done} .outcome a.open-large")
    expect(page.locator("#large-name")).to_have_text("1 of 2: thumbnails/orbit.png")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#large-name")).to_have_text("2 of 2: thumbnails/render_000120.png")
    page.click("#large-next")
    expect(page.locator("#large-name")).to_have_text("1 of 2: thumbnails/orbit.png")
    page.click("#large-close")
    expect(page.locator("#large")).to_have_count(0)
    assert seen.faults == []


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_large_view_fits_and_can_be_read(
    width: int, scheme: str, looked: Service, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page(width, scheme)
    large(page, "#rig-lab3x3 figure")
    for _ in range(2):  # all cameras, and then one
        assert page.evaluate("document.documentElement.scrollWidth") == width
        assert page.evaluate("(d => d.scrollWidth - d.clientWidth)(document.querySelector('#cells'))") == 0
        assert page.evaluate(SMALLEST) >= 12
        assert page.evaluate(CONTRAST) == []
        page.keyboard.press("9")
    expect(page.locator(".cell:visible")).to_have_count(1)
    assert seen.faults == []


def test_a_new_look_is_shown_where_there_is_a_token(looked: Service, open_page: Callable[..., Any]) -> None:
    number = [0]

    def status(route: Any) -> None:
        found = route.fetch().json()
        found["look"]["etag"] = f'"look-{number[0]}"'
        route.fulfill(json=found)

    def prepare(page: Any) -> None:
        page.add_init_script("localStorage.setItem('spike4dgs-token', 'secret')")
        page.route("**/v1/rigs/lab3x3/status", status)

    page = open_page(prepare=prepare)
    drawn(page, "#rig-lab3x3 figure img")
    number[0] = 1
    page.click("#preflight-lab3x3")
    expect(page.locator("#rig-lab3x3 figure img")).to_have_attribute(
        "data-source", "/v1/rigs/lab3x3/look.png?of=%22look-1%22"
    )
    drawn(page, "#rig-lab3x3 figure img")
    assert page.locator("#rig-lab3x3 figure img").get_attribute("src").startswith("blob:")
    page.unroute_all(behavior="ignoreErrors")  # one that is under way would fail in the next test


@pytest.mark.parametrize("width", [400, 1280])
def test_a_training_shows_what_it_has_learnt(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen, width: int
) -> None:
    page = open_page(width=width)
    job = service.client.submit(ReconstructRequest(capture=capture.id, holdout="cam11")).id
    box, picture = page.locator(f"#preview-{job}"), page.locator(f"#preview-img-{job}")
    box.wait_for()
    begun = [box.bounding_box()[side] for side in ("width", "height")]
    drawn(page, f"#preview-img-{job}")
    expect(box).to_have_text(re.compile(r"^Rendered as cam11, step \d+, \d s ago$"))
    first = picture.get_attribute("src")
    assert re.fullmatch(rf"What {job} has learnt by step \d+, as cam11 would see it", picture.get_attribute("alt"))
    assert [box.bounding_box()[side] for side in ("width", "height")] == begun  # nothing has been moved aside
    wait_for(lambda: picture.get_attribute("src") != first)
    expect(box).to_contain_text(re.compile("step [12]00,"))
    page.click(f"#preview-{job} a.open-large")
    wait_for(lambda: page.locator("#large-picture").evaluate("one => one.naturalWidth") == 160)
    page.keyboard.press("Escape")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    expect(page.locator(f"#job-{job} .status")).to_have_text("done")
    expect(box).to_have_count(0)
    drawn(page, f"#job-{job} .outcome img")
    assert seen.faults == []
