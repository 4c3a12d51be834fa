"""The operator's page in a real browser, before a real service whose stages are played by fake_stage.py."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from maintenance.operator_page import BROWSER, CONTRAST, EVIL, LONG_MS, Seen, Service, drawn, expect, newest
from maintenance.waiting import wait_for

from server.schemas.captures import Capture
from server.schemas.job_types import ReconstructRequest

pytestmark = BROWSER
VIEWER = "A viewer's token only looks on; this needs an operator's."


def test_capture_to_report_by_clicks(service: Service, open_page: Callable[..., Any], seen: Seen) -> None:
    page = open_page()
    expect(page.locator("#ready")).to_have_text("Ready")
    page.fill("#ticks-lab3x3", "100")
    expect(page.locator("#ms-lab3x3")).to_have_value("5")
    page.fill("#ms-lab3x3", "4")
    expect(page.locator("#ticks-lab3x3")).to_have_value("80")
    page.fill("#name-lab3x3", "by clicks")
    page.click("#record-lab3x3")
    card = page.locator("#captures > li", has_text="by clicks").first
    expect(card.locator(".status")).to_have_text("done")
    expect(card).to_contain_text("80 ticks, 4.0 ms")
    card.get_by_role("button", name="Reconstruct…").click()
    page.get_by_label("Motion model").select_option("cubic")
    page.get_by_label("Time budget (s)").fill("90")
    page.locator("#dialog-go").click()
    expect(page.locator("#dialog")).to_have_count(0)
    job = page.locator(f"#job-{newest(service)}")
    expect(job.locator("progress")).to_be_visible(timeout=LONG_MS)
    expect(job.locator(".curve figcaption")).to_contain_text("Training images: training PSNR")
    expect(job.locator(".status")).to_have_text("done")
    asked = service.client.job(newest(service)).request.model_dump()
    assert (asked["model"], asked["budget_s"], asked["holdout"], asked["views"]) == ("cubic", 90, "cam11", None)
    expect(job.locator(".curve figcaption")).to_have_text(
        "Held-out camera during training: held-out PSNR 32.65 dB after 32.0 s"
    )
    expect(job).to_contain_text("Final score on the held-out camera: held-out PSNR 32.50 dB, SSIM 0.950")
    assert job.get_by_role("link", name="View in 4D").get_attribute("href") == f"/viewer.html?job={newest(service)}"
    job.get_by_text("Results").click()
    page.wait_for_function("document.querySelector('video').readyState > 0")
    with page.expect_download() as download:
        job.get_by_role("link", name="metrics.json").click()
    assert json.loads(Path(download.value.path()).read_text())["psnr_db"] == 32.5
    job.get_by_text("Log", exact=True).click()
    expect(job.locator("pre[id^=log]")).to_contain_text("--stage train --model cubic")
    job.get_by_role("link", name="Report", exact=True).click()
    expect(page.frame_locator("#report").locator("html")).to_contain_text("")
    wait_for(lambda: page.frames[1].title() == "report")
    assert seen.faults == []
    assert seen.hosts <= {service.address, "about:/srcdoc", "about:srcdoc", "data:,"}


def test_a_rig_is_looked_at_checked_and_calibrated(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    rig = page.locator("#rig-lab3x3")
    page.click("#look-lab3x3")
    expect(rig.locator(".title")).to_contain_text("looking")
    drawn(page, "#rig-lab3x3 figure img")
    drawn(page, f"#capture-{capture.id} img.preview")
    page.click("#preflight-lab3x3")
    expect(rig.locator("p.failed")).to_have_text(["disk speed: found 9 MB/s, expected 99 MB/s; a faster disk"])
    expect(page.locator("#jobs > li").first).to_contain_text("Not ready: disk speed 9 MB/s")
    expect(rig).to_contain_text("Calibration: version 0, as drawn")
    page.click(f"#more-{capture.id} summary")
    page.click(f"#calibrate-{capture.id}")
    page.locator("#dialog-go").click()
    expect(page.locator("#said")).to_have_text("The calibration is queued")
    expect(rig).to_contain_text("Calibration: version 1, from a scene, just now, 0.10 px residual")
    page.click("#calibrations-lab3x3 summary")
    page.click("#use-lab3x3-0")
    expect(rig).to_contain_text("Calibration: version 0, as drawn")
    page.click(f"#calibrate-{capture.id}")
    page.locator("#dialog summary").click()
    page.get_by_label("Use it at once").uncheck()
    page.locator("#dialog-go").click()
    expect(rig.locator("#use-lab3x3-2")).to_be_visible()
    assert service.client.current_calibration("lab3x3").version == 0
    assert seen.faults == []


def test_a_viewers_token_changes_nothing(capture: Capture, done: str, open_page: Callable[..., Any]) -> None:
    def looking_on(page: Any) -> None:
        def answer(route: Any) -> None:
            route.fulfill(json=route.fetch().json() | {"role": "viewer"})

        page.route("**/v1/info", answer)

    page = open_page(prepare=looking_on)
    expect(page.locator("#role")).to_be_visible()
    expect(page.locator(f"#export-{done}")).to_be_disabled()
    expect(page.locator(f"#reconstruct-{capture.id}")).to_have_attribute("title", VIEWER)
    assert page.locator("#form-lab3x3").count() == 0
    enabled = page.locator("main button:not(:disabled)").all_inner_texts()
    assert [text for text in enabled if not text.startswith("More")] == []
    expect(page.get_by_role("link", name="Report", exact=True).first).to_be_visible()


def test_cancel_resume_and_restart_by_keyboard(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    opener = page.locator(f"#reconstruct-{capture.id}")
    opener.focus()
    page.keyboard.press("Enter")
    expect(page.locator("#dialog")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.locator("#dialog")).to_have_count(0)
    expect(opener).to_be_focused()
    page.keyboard.press("Enter")
    page.get_by_label("Name").last.focus()
    page.keyboard.type("by keys")
    page.keyboard.press("Enter")
    expect(page.locator("#dialog")).to_have_count(0)
    job_id = newest(service)
    job = page.locator(f"#job-{job_id}")
    expect(job.locator(".curve figcaption")).to_be_visible(timeout=LONG_MS)
    page.focus(f"#cancel-{job_id}")
    expect(page.locator(f"#cancel-{job_id}")).to_be_focused()
    page.wait_for_timeout(1500)  # the list is asked for anew meanwhile
    expect(page.locator(f"#cancel-{job_id}")).to_be_focused()
    page.keyboard.press("Enter")
    expect(job.locator(".status")).to_have_text("cancelled")
    expect(job).to_be_focused()  # what had the focus is gone
    wait_for(lambda: (service.data / "jobs" / job_id / "run" / "attempts.txt").exists())
    page.focus(f"#resume-{job_id}")
    page.keyboard.press("Enter")
    expect(job.locator(".status")).to_have_text("done")
    page.focus(f"#manage-{job_id} summary")
    page.keyboard.press("Enter")
    page.locator(f"#stage-{job_id}").select_option("train")
    page.focus(f"#restart-{job_id}")
    page.keyboard.press("Enter")
    wait_for(lambda: service.client.log(job_id).count("--stage train") >= 3)
    service.wait(job_id, "done")
    expect(page.locator(f"#delete-{job_id}")).to_be_visible(timeout=LONG_MS)
    page.focus(f"#delete-{job_id}")
    page.keyboard.press("Enter")
    expect(page.locator("#dialog-back")).to_be_focused()  # the safe answer
    page.keyboard.press("Shift+Tab")
    page.keyboard.press("Enter")
    expect(job).to_have_count(0)
    assert job_id not in [one.id for one in service.client.jobs()]
    # The browser itself tells of each 409 while the stage stops, and of a 404 for what was asked for as it was deleted.
    assert [fault for fault in seen.faults if not fault.endswith(("409 (Conflict)", "404 (Not Found)"))] == []


def test_an_endless_capture_is_stopped(service: Service, open_page: Callable[..., Any], seen: Seen) -> None:
    page = open_page()
    page.get_by_label("Until stopped").check()
    expect(page.locator("#ticks-lab3x3")).to_be_disabled()
    page.fill("#pre-lab3x3", "50")
    page.fill("#name-lab3x3", "endless")
    page.click("#record-lab3x3")
    card = page.locator("#captures > li", has_text="endless")
    expect(card.locator(".status")).to_have_text("recording")
    expect(page.locator("#record-lab3x3")).to_be_disabled()
    expect(page.locator("#ticks-lab3x3")).to_be_disabled()
    made = service.client.captures(limit=1)[0]
    asked = service.client.capture(made.id)
    assert (asked.name, asked.ticks) == ("endless", None)
    card.get_by_role("button", name="Save from the pre-trigger").click()
    expect(card).to_contain_text("saved")  # stopped before it began, it would keep nothing
    card.get_by_role("button", name="Stop").click()
    expect(card.locator(".status")).to_have_text("done")
    assert seen.faults == []


def test_a_reconstruction_begins_while_its_capture_is_recorded(
    service: Service, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    page.get_by_label("Until stopped").check()
    page.fill("#name-lab3x3", "followed")
    page.click("#record-lab3x3")
    card = page.locator("#captures > li", has_text="followed")
    expect(card.locator(".status")).to_have_text("recording")
    card.get_by_role("button", name="Reconstruct meanwhile…").click()
    page.get_by_label("Time budget (s)").fill("60")
    page.locator("#dialog-go").click()
    expect(page.locator("#dialog")).to_have_count(0)
    job = page.locator(f"#job-{newest(service)}")
    expect(job).to_contain_text("begun while it was recorded")
    expect(job.locator(".stages li").first).to_contain_text("follow")
    asked = service.client.job(newest(service)).request.model_dump()
    assert (asked["follow"], asked["budget_s"], asked["holdout"]) == (True, 60, "cam11")
    expect(card.locator(".status")).to_have_text("recording")
    card.get_by_role("button", name="Stop").click()
    expect(job.locator(".status")).to_have_text("done")
    assert seen.faults == []


def test_a_capture_stopped_before_anything_was_kept_is_cancelled_and_says_so(
    service: Service, open_page: Callable[..., Any], seen: Seen
) -> None:
    page = open_page()
    page.get_by_label("Until stopped").check()
    page.fill("#pre-lab3x3", "50")
    page.fill("#name-lab3x3", "never saved")
    page.click("#record-lab3x3")
    card = page.locator("#captures > li", has_text="never saved")
    expect(card).to_contain_text("armed")
    card.get_by_role("button", name="Stop").click()
    expect(card.locator(".status")).to_have_text("cancelled")
    expect(card).to_contain_text("stopped before it was told to save, so nothing was kept")
    assert seen.faults == []


def test_a_failed_job_shows_its_line(
    service: Service, capture: Capture, open_page: Callable[..., Any], seen: Seen
) -> None:
    fault = service.data / "jobs" / "fail-points"
    fault.touch()
    job = service.client.submit(ReconstructRequest(capture=capture.id, name="broken"))
    service.wait(job.id, "failed")
    fault.unlink()
    card = open_page().locator(f"#job-{job.id}")
    expect(card.locator("p.failed")).to_have_text("points: found a fault, expected none; mend it")
    expect(card.locator("li.failed")).to_contain_text("points")
    expect(card.get_by_role("button", name="Resume")).to_be_visible()
    assert seen.faults == []


def test_names_are_text_and_never_html(capture: Capture, done: str, open_page: Callable[..., Any], seen: Seen) -> None:
    page = open_page()
    expect(page.locator(f"#capture-{capture.id} h3")).to_have_text(EVIL)
    expect(page.locator(f"#job-{done} h3")).to_have_text(f"Reconstruction of {EVIL}")
    page.click(f"#reconstruct-{capture.id}")
    expect(page.locator("#dialog-title")).to_have_text(f"Reconstruct {EVIL}")
    assert page.locator("img[src=x], main b, dialog b").count() == 0
    assert seen.faults == []


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_fits_and_can_be_read(width: int, scheme: str, done: str, open_page: Callable[..., Any], seen: Seen) -> None:
    page = open_page(width, scheme)
    page.locator(f"#job-{done} figcaption").wait_for()
    for name in ("results", "log", "manage"):
        page.click(f"#{name}-{done} summary")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    page.click(f"#export-{done}")
    page.click("#dialog summary")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.evaluate("(d => d.scrollWidth - d.clientWidth)(document.querySelector('dialog'))") == 0
    page.click("#dialog-back")
    weak = page.evaluate(CONTRAST)
    assert weak == []
    unnamed = page.evaluate("""[...document.querySelectorAll('button, a[href], input, select')].filter((one) =>
        !(one.textContent.trim() || one.ariaLabel || one.labels?.length || one.querySelector('img')?.alt))
        .map((one) => one.outerHTML)""")
    assert unnamed == []
    assert seen.faults == []


def test_what_is_drawn_anew_right_after_a_click_is_as_the_click_left_it(open_page: Callable[..., Any]) -> None:
    found = open_page().evaluate("""async () => {
        const { element, fold } = await import('/operator/dom.js');
        let drawn = fold('any', 'Any', element('p'));
        document.body.append(drawn);
        const clicked = () => {
            drawn.querySelector('summary').click();
            const anew = fold('any', 'Any', element('p'));
            drawn.replaceWith(anew);
            drawn = anew;
            return drawn.open;
        };
        const first = clicked();
        await new Promise((done) => setTimeout(done, 100));
        return [first, drawn.open, clicked()];
    }""")
    assert found == [True, True, False]


def test_a_token_is_asked_for_and_used(done: str, open_page: Callable[..., Any]) -> None:
    def guarded(page: Any) -> None:
        def answer(route: Any) -> None:
            if route.request.headers.get("authorization") == "Bearer secret":
                route.continue_()
            else:
                body = json.dumps({"status": 401, "detail": "found no token, expected one"})
                route.fulfill(status=401, content_type="application/problem+json", body=body)

        page.route("**/v1/**", answer)

    page = open_page(prepare=guarded)
    expect(page.locator("#token-form")).to_be_visible()
    page.fill("#token", "wrong")
    page.keyboard.press("Enter")
    expect(page.locator("#notice")).to_have_text("The service does not know this token.")
    page.fill("#token", "secret")
    page.keyboard.press("Enter")
    expect(page.locator("#ready")).to_have_text("Ready")
    expect(page.locator("#token-form")).to_be_hidden()
    page.click(f"#results-{done} summary")
    page.wait_for_function("document.querySelector('video').readyState > 0")
    assert page.locator(f"#results-{done} video").get_attribute("src").startswith("blob:")
    with page.expect_download() as download:
        page.locator(f"#results-{done}").get_by_role("link", name="metrics.json").click()
    assert json.loads(Path(download.value.path()).read_text())["psnr_db"] == 32.5
    assert page.evaluate("[localStorage.length, sessionStorage.length, document.cookie]") == [1, 0, ""]
    page.locator(f"#report-{done}").click()
    expect(page.locator("#report")).to_have_attribute("srcdoc", "<title>report</title>")


def test_events_move_the_page(service: Service, done: str, open_page: Callable[..., Any], seen: Seen) -> None:
    """Events are applied as they come, before any list is asked for again."""
    job = json.loads(service.client.job(done).model_dump_json()) | {"status": "running", "stage": "train"}

    def listing(route: Any) -> None:
        route.fulfill(json={"items": [job], "next": None})

    def progress(seq: int) -> str:
        message = f"step {seq}, loss 0.1, training PSNR {20 + seq}.00 dB, 9 Gaussians"
        data = {"stage": "train", "fraction": seq / 10, "message": message, "seconds": {"train": seq}, "error": None}
        event = {"seq": seq, "entry": done, "at": 1.0, "kind": "progress", "data": data}
        return f"id: {seq}\r\nevent: progress\r\ndata: {json.dumps(event)}\r\n\r\n"

    def prepare(page: Any) -> None:
        page.route("**/v1/jobs?*", listing)
        stream = ": hello\n\n" + "".join(progress(seq) for seq in (1, 2, 3))
        page.route(
            "**/v1/jobs/*/events*", lambda route: route.fulfill(content_type="text/event-stream", body=": old\n\n")
        )
        page.route("**/v1/events", lambda route: route.fulfill(content_type="text/event-stream", body=stream))

    card = open_page(prepare=prepare).locator(f"#job-{done}")
    expect(card.locator(".curve figcaption")).to_have_text("Training images: training PSNR 23 dB after 3.0 s")
    assert seen.faults == []
