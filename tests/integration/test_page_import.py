"""Import of `.dat` files by drag and drop, in a real browser before a service of fake_stage.py."""

import base64
import hashlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from maintenance.operator_page import BROWSER, CONTRAST, Seen, Service, expect
from maintenance.waiting import wait_for

from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.sensor import Sensor
from rigs.toml import catalog_rig, dump_rig, load_rig
from server.schemas.captures import Capture, ImportRequest

pytestmark = BROWSER
PREVIEWS = "(n) => [...document.querySelectorAll('.peek')].filter((one) => one.naturalWidth > 0).length === n"
IDS = catalog_rig("lab3x3").ids
DROP = """([onto, files]) => {
  const transfer = new DataTransfer();
  for (const [name, bits] of files) {
    const bytes = Uint8Array.from(atob(bits), (one) => one.charCodeAt(0));
    transfer.items.add(new File([bytes], name));
  }
  const place = document.querySelector(onto);
  for (const type of ['dragover', 'drop']) {
    place.dispatchEvent(new DragEvent(type, { dataTransfer: transfer, bubbles: true, cancelable: true }));
  }
}"""


def spikes(layout: PlaneLayout, number: int, planes: int = 40) -> bytes:
    """The stream of a camera before blocks of light."""
    height, width = layout.height, layout.width
    blocks = np.random.default_rng(number).uniform(0.05, 0.5, (height // 11 + 1, width // 11 + 1))
    light = np.kron(blocks, np.ones((11, 11)))[:height, :width].astype(np.float32)
    return pack(Sensor(width, height, "real", 1, number).expose(np.repeat(light[None], planes, 0)), layout).tobytes()


@pytest.fixture(scope="module")
def dats(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Nine streams of 400x250, whose names count from 1 to 9 and so tell an order but no camera."""
    folder = tmp_path_factory.mktemp("dats")
    paths = [folder / f"view {number + 1}.dat" for number in range(9)]
    for number, path in enumerate(paths):
        path.write_bytes(spikes(PlaneLayout(400, 250), number))
    return paths


def chosen(page: Any, paths: list[Path]) -> None:
    """Choose files for an import, and wait until they are sent."""
    expect(page.locator("#rig-lab3x3")).to_be_visible()
    page.set_input_files("#import-input", paths[::-1])
    dats = [path for path in paths if path.suffix == ".dat"]
    expect(page.locator("#import-state")).to_have_text(f"{len(dats)} of {len(dats)} files sent")


def uploads(service: Service) -> set[str]:
    return {one.id for one in service.client.uploads()}


def test_files_become_a_capture_after_a_look_at_them(
    service: Service, dats: list[Path], open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    chosen(page, dats)
    expect(page.locator("#large-title")).to_have_text("Import 9 files")
    names = page.locator(".incoming strong").all_inner_texts()
    cameras = page.locator(".incoming select").evaluate_all("all => all.map((one) => one.value)")
    assert (names, cameras) == ([path.name for path in dats], list(IDS))
    assert page.locator("#import-layout option").first.inner_text().startswith("400 × 250, lsb first")
    page.wait_for_function(PREVIEWS, arg=9)
    assert page.locator(".peek").first.evaluate("one => [one.naturalWidth, one.naturalHeight]") == [400, 250]
    before = page.locator(".peek").first.get_attribute("src")
    page.locator("#import-rows").select_option("top")
    assert page.locator(".peek").first.get_attribute("src") != before
    page.locator("#import-rows").select_option("bottom")
    page.fill("#import-name", "dropped in")
    page.click("#import-go")
    expect(page.locator("#large")).to_have_count(0)
    card = page.locator("#captures > li", has_text="dropped in")
    expect(card.locator(".status")).to_have_text("done")
    (made,) = (one for one in service.client.captures() if one.name == "dropped in")
    manifest = service.client.manifest(made.id)
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in dats]
    assert [camera.sha256 for camera in manifest.cameras] == digests
    assert manifest.tick_rate_hz == 20000
    assert seen.faults == []


def test_a_drop_says_in_a_line_what_does_not_fit(
    service: Service, dats: list[Path], open_page: Callable[..., Any], seen: Seen
) -> None:
    given = {f"cam{n // 3}{n % 3}.dat": path.read_bytes() for n, path in enumerate(dats)}
    given["cam11.dat"] = spikes(PlaneLayout(400, 250, "msb"), 4)
    given["cam12.dat"] += b"12345"
    given |= {"notes.txt": b"hello"}
    page = open_page()
    expect(page.locator("#rig-lab3x3")).to_be_visible()
    before = uploads(service)
    page.evaluate(DROP, ["#captures", [[name, base64.b64encode(bits).decode()] for name, bits in given.items()]])
    expect(page.locator("#import-state")).to_have_text("9 of 9 files sent")
    expect(page.locator("#import-fault")).to_have_text("left out: notes.txt")
    expect(page.locator(".incoming", has_text="cam11.dat").locator("p")).to_have_text(
        "found 400 × 250, msb first likelier than 400 × 250, lsb first; choose it for all, or leave this file out"
    )
    expect(page.locator(".incoming", has_text="cam12.dat").locator("p")).to_have_text(
        "found 5 bytes behind 40 whole planes of 400x250"
    )
    row = page.locator(".incoming", has_text="cam01.dat").locator("select")
    row.select_option("cam02")
    expect(page.locator("#import-fault")).to_have_text(
        "found two files for cam02; choose one camera for each; left out: notes.txt"
    )
    expect(page.locator("#import-go")).to_be_disabled()
    row.select_option("")
    expect(page.locator("#import-fault")).to_contain_text("found no file for cam01 of lab3x3")
    assert len(uploads(service) - before) == 9
    page.locator("#import-layout").focus()
    page.keyboard.press("Escape")  # to Cancel, and once more
    expect(page.locator("#large-close")).to_be_focused()
    page.keyboard.press("Escape")
    expect(page.locator("#large")).to_have_count(0)
    wait_for(lambda: uploads(service) == before)
    assert seen.faults == []


def test_another_size_comes_with_its_rig_file(
    service: Service, tmp_path: Path, open_page: Callable[..., Any], seen: Seen
) -> None:
    for number, camera_id in enumerate(IDS):
        (tmp_path / f"{camera_id}.dat").write_bytes(spikes(PlaneLayout(160, 104), number))
    page = open_page()
    chosen(page, sorted(tmp_path.glob("*.dat")))
    expect(page.locator(".incoming p").first).to_contain_text("neighbouring pixels unlike")
    page.click(".import summary")
    page.fill("#import-width", "160")
    page.fill("#import-height", "104")
    page.click("#import-try")
    expect(page.locator("#import-fault")).to_contain_text("found 160 × 104, lsb first, expected 400 × 250 of lab3x3")
    expect(page.locator("#import-go")).to_be_disabled()
    page.click("#large-close")
    (tmp_path / "small.toml").write_text(dump_rig(catalog_rig("lab3x3").scaled(160, 104)))
    chosen(page, sorted(tmp_path.iterdir()))
    expect(page.locator(".import")).to_contain_text("Cameras of small.toml")
    page.click(".import summary")
    page.fill("#import-width", "160")
    page.fill("#import-height", "104")
    page.click("#import-go")  # as 250x250, which the rig file refuses
    expect(page.locator("#import-fault")).to_contain_text("small.toml: cam00: found the size 160x104")
    page.click("#import-try")
    expect(page.locator("#import-layout option").first).to_contain_text("160 × 104, lsb first")
    page.fill("#import-name", "small ones")
    page.get_by_label("Poses").select_option("of a drawing: find them from the scene")
    page.click("#import-go")
    card = page.locator("#captures > li", has_text="small ones")
    expect(card.locator(".status")).to_have_text("done")
    (capture,) = service.client.captures(limit=1)
    assert load_rig(next(service.data.rglob(f"{capture.id}/rig.toml"))).poses == "nominal"
    assert [fault for fault in seen.faults if "422" not in fault] == []  # the browser itself tells of the refusal


def test_an_upload_goes_on_where_the_connection_broke(
    service: Service, dats: list[Path], tmp_path: Path, open_page: Callable[..., Any]
) -> None:
    long = tmp_path / "cam00.dat"
    long.write_bytes(dats[0].read_bytes() * 28)  # 14 MB, in three pieces
    sent: list[int] = []
    broken = [True]

    def prepare(page: Any) -> None:
        def piece(route: Any) -> None:
            offset = int(route.request.headers["upload-offset"])
            sent.append(offset)
            if offset and broken[0]:
                route.abort()
            else:
                route.continue_()

        page.route(
            "**/v1/uploads/u*", lambda route: piece(route) if route.request.method == "PATCH" else route.continue_()
        )

    page = open_page(prepare=prepare)
    expect(page.locator("#rig-lab3x3")).to_be_visible()
    page.set_input_files("#import-input", [long])
    expect(page.locator(".incoming p")).to_have_text("The service does not answer; check that it runs")
    expect(page.locator("#import-resume")).to_be_visible()
    first = 4 << 20
    assert sent == [0, *[first] * 5]
    assert 0.2 < page.locator(".incoming progress").evaluate("one => one.value") < 0.4
    broken[0] = False
    page.click("#import-resume")
    expect(page.locator("#import-state")).to_have_text("1 of 1 files sent")
    assert sent[6:] == [first, first + (8 << 20)]
    (made,) = (one for one in service.client.uploads() if one.name == "cam00.dat" and one.bytes == long.stat().st_size)
    assert made.sha256 == hashlib.sha256(long.read_bytes()).hexdigest()
    page.unroute_all()  # which would wait for this thread
    page.click("#large-close")
    wait_for(lambda: made.id not in uploads(service))


def test_what_is_no_recording_is_refused_in_a_line(tmp_path: Path, open_page: Callable[..., Any], seen: Seen) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "cam00.dat").write_bytes(b"")
    page = open_page()
    expect(page.locator("#rig-lab3x3")).to_be_visible()
    page.set_input_files("#import-input", [tmp_path / "notes.txt"])
    expect(page.locator("#notice")).to_have_text("found notes.txt, expected .dat files; drop those of a recording")
    page.set_input_files("#import-input", [tmp_path / "cam00.dat"])
    expect(page.locator("#notice")).to_contain_text("found no bytes in cam00.dat")
    assert page.locator("#large").count() == 0
    assert seen.faults == []


@pytest.mark.parametrize(("width", "scheme"), [(400, "dark"), (1280, "light")])
def test_the_import_fits_and_can_be_read(
    width: int, scheme: str, dats: list[Path], open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page(width, scheme)
    chosen(page, dats)
    page.wait_for_function(PREVIEWS, arg=9)
    assert page.evaluate("(d => d.scrollWidth - d.clientWidth)(document.querySelector('.import'))") == 0
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.evaluate(CONTRAST) == []
    unnamed = """[...document.querySelectorAll('#large input, #large select, #large button')].filter((one) =>
        !(one.textContent.trim() || one.ariaLabel || one.labels?.length)).map((one) => one.outerHTML)"""
    assert page.evaluate(unnamed) == []
    page.click("#large-close")
    assert seen.faults == []


def test_cameras_of_any_name_are_offered_and_scored_on(
    service: Service, dats: list[Path], tmp_path: Path, open_page: Callable[..., Any], seen: Seen
) -> None:
    rig, names = catalog_rig("lab3x3"), ["left", "right", "top-1", "top-2"]
    cameras = tuple(replace(camera, id=name) for camera, name in zip(rig.cameras, names, strict=False))
    (tmp_path / "four.toml").write_text(dump_rig(replace(rig, cameras=cameras)))
    sent = {name: service.client.send_file(path).id for name, path in zip(names, dats, strict=False)}
    cameras_id = service.client.send_file(tmp_path / "four.toml").id
    asked = {"uploads": sent, "cameras": cameras_id, "tick_rate_hz": 20_000, "name": "four"}
    made = service.client.import_capture(ImportRequest.model_validate(asked))
    wait_for(lambda: service.client.capture(made.id).status == "done")
    page = open_page()
    card = page.locator(f"#capture-{made.id}")
    expect(card).to_contain_text("No plane lost")
    card.get_by_role("button", name="Reconstruct…").click()
    expect(page.locator("#option-holdout option")).to_have_text(["none", *names])
    expect(page.locator("#option-holdout")).to_have_value("top-1")
    page.locator("#option-holdout").select_option("left")
    page.click("#dialog-go")
    expect(page.locator("#dialog")).to_have_count(0)
    (job,) = service.client.jobs(capture=made.id)
    assert job.request.model_dump()["holdout"] == "left"
    service.client.cancel(job.id)
    assert seen.faults == []


def test_a_recording_that_cannot_be_read_is_not_called_whole(
    service: Service, capture: Capture, open_page: Callable[..., Any]
) -> None:
    busy, asked = [True], [0]

    def answer(route: Any) -> None:
        asked[0] += 1
        if busy[0]:
            route.fulfill(status=503, content_type="application/problem+json", body='{"detail": "found no time"}')
        else:
            route.continue_()

    page = open_page(prepare=lambda page: page.route(f"**/v1/captures/{capture.id}/manifest", answer))
    card = page.locator(f"#capture-{capture.id}")
    expect(card.locator("p.failed")).to_have_text("What it holds cannot be told: found no time")
    expect(card).not_to_contain_text("No plane lost")
    busy[0] = False
    expect(card).to_contain_text("No plane lost")
    manifest = service.data / "captures" / capture.id / "recording.json"
    manifest.rename(manifest.with_suffix(".away"))
    page.reload()
    expect(card.locator("p.failed")).to_contain_text(f"found the recording of {capture.id} damaged")
    expect(card).not_to_contain_text("No plane lost")
    known = asked[0]
    page.get_by_label("Search").fill(capture.id)
    expect(page.locator("#found")).to_contain_text("Found 1 capture")
    assert asked[0] == known
    manifest.with_suffix(".away").rename(manifest)
