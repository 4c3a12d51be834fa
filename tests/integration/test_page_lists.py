"""The lists of the operator's page: searched, labelled, chosen from, in the order of the work."""

import re
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from maintenance.operator_page import BROWSER, Seen, Service
from maintenance.waiting import wait_for

from server.client import ServiceClient
from server.schemas.captures import Capture, CaptureRequest, Labels
from server.schemas.job_types import JOB_TYPES, JobBase, ReconstructRequest
from server.schemas.jobs import Job

pytestmark = BROWSER
Open = Callable[..., Any]
LONG_MS = 60_000
# Clicks the box of all, and says whether every box of a card shows it before the page is drawn again.
BOXES_FOLLOW = """all => {
  all.click();
  return [...document.querySelectorAll("#jobs .choose")].every((one) => one.checked === all.checked);
}"""


def expect(locator: Any) -> Any:
    from playwright import sync_api

    sync_api.expect.set_options(timeout=LONG_MS)
    return sync_api.expect(locator)


@pytest.fixture(scope="module")
def pair(service: Service) -> list[Capture]:
    """Two finished captures, the older first."""
    made = []
    for name in ("Lüfter 100 %", "ball"):
        capture = service.client.start_capture("lab3x3", CaptureRequest(ticks=40, name=name))
        wait_for(lambda capture=capture: service.client.capture(capture.id).status == "done")
        made.append(capture)
    return made


def asked(kind: str, **fields: object) -> JobBase:
    return JOB_TYPES[kind].model_validate({"type": kind, **fields})


@pytest.fixture
def queue(service: Service, pair: list[Capture]) -> Iterator[list[Job]]:
    """A reconstruction at work and two that wait, of which the second was asked for more urgently."""
    hold = service.data / "jobs" / "hold-train"
    hold.touch()
    requests = [ReconstructRequest(capture=pair[0].id, budget_s=600, name=f"queued {n}") for n in range(2)]
    requests += [ReconstructRequest(capture=pair[0].id, budget_s=600, name="urgent", priority=1)]
    jobs = [service.client.submit(requests[0])]
    service.wait(jobs[0].id, "running")
    jobs += [service.client.submit(request) for request in requests[1:]]
    yield jobs
    for job in service.client.jobs():
        if job.status in ("queued", "running"):
            service.client.cancel(job.id)
    hold.unlink()
    wait_for(lambda: not service.client.jobs(status="running") and not service.client.jobs(status="queued"))


def order(page: Any) -> list[str]:
    return [text.removeprefix("job-") for text in page.locator("#jobs > li").evaluate_all("all => all.map(o => o.id)")]


def test_what_runs_comes_first_then_the_queue(queue: list[Job], done: str, open_page: Open, seen: Seen) -> None:
    page = open_page()
    first, second, urgent = (job.id for job in queue)
    waiting = page.locator(f"#job-{second}")
    expect(waiting).to_contain_text("2nd in the queue of reconstructions · begins about ")
    assert order(page)[:3] == [first, urgent, second]
    assert order(page).index(done) > 2
    expect(page.locator(f"#job-{urgent}")).to_contain_text("1st in the queue of reconstructions")
    expect(page.locator(f"#job-{first}")).to_contain_text(re.compile(r"ends about \d\d:\d\d"))
    page.fill(f"#priority-{second}", "1")
    page.fill(f"#priority-{urgent}", "900")
    page.click(f"#prioritise-{urgent}")
    expect(page.locator(f"#job-{urgent}")).to_contain_text("2nd in the queue")
    assert order(page)[:3] == [first, second, urgent]
    assert seen.faults == []


def test_search_is_said_and_leaves_the_forms_whole(
    service: Service, pair: list[Capture], done: str, open_page: Open, seen: Seen
) -> None:
    service.client.label_job(done, Labels(note="for the poster\n100 % sharp"))
    page = open_page()
    shown = page.locator("#captures > li")
    expect(page.locator(f"#capture-{pair[0].id}")).to_be_visible()
    page.get_by_label("Search").fill("100 %")
    expect(page.locator("#found")).to_have_text(re.compile(r"^Found 1 capture and \d+ jobs?$"))
    assert page.locator("#found").get_attribute("role") == "status"
    expect(shown).to_have_count(1)
    expect(page.locator(f"#job-{done} .note")).to_have_text("for the poster\n100 % sharp")
    page.get_by_label("Search").fill("no such thing")
    expect(page.locator("#found")).to_have_text("Found 0 captures and 0 jobs")
    expect(page.locator("#no-captures")).to_have_text("No such captures.")
    expect(page.locator("#rig-lab3x3")).not_to_contain_text("Record a capture to calibrate from")
    page.keyboard.press("Escape")
    expect(page.locator(f"#capture-{pair[1].id}")).to_be_visible()
    expect(page.locator("#found")).to_have_text("")
    assert seen.faults == []


def test_a_note_is_written_by_keyboard(service: Service, pair: list[Capture], open_page: Open, seen: Seen) -> None:
    page = open_page()
    card = page.locator(f"#capture-{pair[1].id}")
    page.focus(f"#more-{pair[1].id} summary")
    page.keyboard.press("Enter")
    page.focus(f"#label-{pair[1].id}")
    page.keyboard.press("Enter")
    expect(page.locator("#label-note")).to_be_focused()
    page.keyboard.type("one lamp\nwas <b>off</b>")
    page.fill("#label-name", "red ball")
    page.focus("#dialog-go")
    page.keyboard.press("Enter")
    expect(card.locator(".note")).to_have_text("one lamp\nwas <b>off</b>")
    expect(card.locator("h3")).to_have_text("red ball")
    kept = service.client.capture(pair[1].id)
    assert (kept.name, kept.note) == ("red ball", "one lamp\nwas <b>off</b>")
    page.click(f"#label-{pair[1].id}")
    page.fill("#label-note", "")
    page.click("#dialog-go")
    expect(card.locator(".note")).to_have_count(0)
    assert service.client.capture(pair[1].id).note is None
    assert seen.faults == []


def jobs_of(client: ServiceClient, capture: str, kind: str) -> list[Job]:
    return client.jobs(capture=capture, type=kind)


def test_one_form_queues_jobs_for_many(service: Service, pair: list[Capture], open_page: Open, seen: Seen) -> None:
    page = open_page()
    for capture in pair:
        page.focus(f"#choose-{capture.id}")
        page.keyboard.press("Space")
    expect(page.locator("#chosen-captures")).to_have_text("2 captures chosen")
    assert page.locator("#chosen-captures").get_attribute("role") == "status"
    page.get_by_role("button", name="Queue jobs for 2…").click()
    page.locator("#batch-type").select_option("images")
    page.get_by_label("Method").select_option("tfi")
    page.fill("#option-name", "all of them")
    page.click("#dialog-go")
    expect(page.locator("#said")).to_have_text("2 captures have a job queued")
    expect(page.locator("#chosen-captures")).to_have_text("")
    for capture in pair:
        (job,) = jobs_of(service.client, capture.id, "images")
        assert (job.name, job.request.model_dump()["method"]) == ("all of them", "tfi")
    assert seen.faults == []


def test_what_is_refused_is_named_and_the_rest_is_done(service: Service, pair: list[Capture], open_page: Open) -> None:
    gone = service.client.start_capture("lab3x3", CaptureRequest(ticks=40, name="soon gone"))
    wait_for(lambda: service.client.capture(gone.id).status == "done")
    page = open_page()
    for capture in (gone, pair[0]):
        page.check(f"#choose-{capture.id}")
    page.get_by_role("button", name="Queue jobs for 2…").click()
    page.locator("#batch-type").select_option("verify")
    service.client.delete_capture(gone.id)
    page.click("#dialog-go")
    expect(page.locator("#notice")).to_contain_text("1 of 2 have a job queued. Refused: soon gone: found no capture")
    assert len(jobs_of(service.client, pair[0].id, "verify")) == 1


def test_captures_are_deleted_together(
    service: Service, queue: list[Job], pair: list[Capture], open_page: Open
) -> None:
    extra = []
    for number in range(2):
        extra.append(service.client.start_capture("lab3x3", CaptureRequest(ticks=40, name=f"extra {number}")))
        wait_for(lambda: service.client.capture(extra[-1].id).status == "done")
    page = open_page()
    for capture in (*extra, pair[0]):
        expect(page.locator(f"#capture-{capture.id}")).to_contain_text("No plane lost")  # so its size is known
        page.check(f"#choose-{capture.id}")
    page.get_by_role("button", name="Delete 3…").click()
    expect(page.locator("#dialog-title")).to_have_text(re.compile(r"^Delete 3 captures, \d+(\.\d)? MiB\?$"))
    expect(page.locator("#dialog li")).to_have_text(["extra 1", "extra 0", "Lüfter 100 %"])
    expect(page.locator("#dialog-back")).to_be_focused()  # the safe answer
    page.click("#dialog-go")
    said = page.locator("#notice")
    expect(said).to_contain_text(f"2 of 3 deleted. Refused: Lüfter 100 %: found {pair[0].id} in use by")
    left = {capture.id for capture in service.client.captures()}
    assert pair[0].id in left
    assert left.isdisjoint(one.id for one in extra)
    expect(page.locator("#chosen-captures")).to_have_text("1 capture chosen")  # what was refused stays chosen


def test_jobs_are_cancelled_exported_and_deleted_together(
    service: Service, queue: list[Job], done: str, open_page: Open, seen: Seen
) -> None:
    page = open_page()
    page.check("#choose-all-jobs")
    number = page.locator("#jobs > li").count()
    expect(page.locator("#chosen-jobs")).to_have_text(f"{number} jobs chosen")
    page.uncheck(f"#choose-{done}")
    assert page.locator("#choose-all-jobs").evaluate("one => one.indeterminate")
    page.get_by_role("button", name="Cancel 3", exact=True).click()
    expect(page.locator("#said")).to_have_text("3 jobs cancelled")
    for job in queue:
        expect(page.locator(f"#job-{job.id} .status")).to_have_text("cancelled")
        expect(page.locator(f"#choose-{job.id}")).not_to_be_checked()
    wait_for(lambda: not service.client.jobs(status="running"))
    for _ in range(2):
        assert page.locator("#choose-all-jobs").evaluate(BOXES_FOLLOW)
    page.check(f"#choose-{done}")
    page.check(f"#choose-{queue[1].id}")
    page.get_by_role("button", name="Export 1…").click()
    page.get_by_label("Format").select_option("ply")
    with page.expect_response(lambda answer: answer.url.endswith("/artefacts")):  # else it asks as the job is deleted
        page.click("#dialog-go")
    wait_for(lambda: any(job.type == "export" for job in service.client.jobs()))
    (export,) = service.client.jobs(type="export")
    assert export.request.model_dump()["job"] == done
    wait_for(lambda: service.client.job(export.id).status not in ("queued", "running"))
    page.check(f"#choose-{export.id}")
    page.check(f"#choose-{queue[1].id}")
    page.get_by_role("button", name="Delete 2…").click()
    expect(page.locator("#dialog-title")).to_contain_text("Delete 2 jobs, ")
    page.click("#dialog-go")
    expect(page.locator("#said")).to_have_text("2 jobs deleted")
    assert {export.id, queue[1].id}.isdisjoint(job.id for job in service.client.jobs())
    assert seen.faults == []


def test_what_was_refused_is_done_again_with_other_options(
    service: Service, pair: list[Capture], open_page: Open, seen: Seen
) -> None:
    fault = service.data / "jobs" / "refuse-points"
    fault.touch()
    request = ReconstructRequest(
        capture=pair[0].id, name="dark", model="cubic", tick_stride=7, views=["cam00", "cam02"], budget_s=33
    )
    job = service.client.submit(request)
    service.wait(job.id, "failed")
    fault.unlink()
    page = open_page()
    card = page.locator(f"#job-{job.id}")
    expect(card.locator("p.failed")).to_have_text(
        "points: found a dark scene, expected some light; change “Planes between instants”"
    )
    expect(card.get_by_role("button", name="Resume")).to_have_count(0)
    card.get_by_role("button", name="Do again with other options…").click()
    page.locator("#dialog summary").click()
    expect(page.get_by_label("Planes between instants")).to_have_value("7")
    page.get_by_label("Planes between instants").fill("3")
    page.click("#dialog-go")
    expect(page.locator("#dialog")).to_have_count(0)
    made = service.client.jobs(limit=1)[0]
    assert made.request.model_dump() == request.model_dump() | {"tick_stride": 3, "name": None}
    assert made.name == "dark"
    service.client.cancel(made.id)
    assert not service.client.job(job.id).resumable
    assert seen.faults == []


def test_results_are_lines_with_labels(service: Service, pair: list[Capture], done: str, open_page: Open) -> None:
    job = service.client.submit(asked("calibrate", capture=pair[0].id))
    service.wait(job.id, "done")
    assert str(service.data) not in service.client.artefact(job.id, "result.json").decode()
    page = open_page()
    page.click(f"#results-{job.id} summary")
    lines = page.locator(f"#results-{job.id} dl")
    expect(lines).to_contain_text("cam00: residual")
    expect(lines).to_contain_text("0.1 px")
    assert "{" not in page.locator(f"#job-{job.id}").inner_text()
    card = page.locator(f"#job-{done}")
    expect(card).to_contain_text("Held-out camera during training: held-out PSNR 32.65 dB")
    expect(card).to_contain_text("Final score on the held-out camera: held-out PSNR 32.50 dB")


def test_a_viewer_chooses_nothing(pair: list[Capture], open_page: Open) -> None:
    def looking_on(page: Any) -> None:
        page.route("**/v1/info", lambda route: route.fulfill(json=route.fetch().json() | {"role": "viewer"}))

    page = open_page(prepare=looking_on)
    expect(page.locator(f"#capture-{pair[0].id}")).to_be_visible()
    assert page.locator("input[id^=choose]").count() == 0
    page.click(f"#more-{pair[0].id} summary")
    expect(page.locator(f"#label-{pair[0].id}")).to_be_disabled()


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_lists_fit(width: int, scheme: str, pair: list[Capture], done: str, open_page: Open, seen: Seen) -> None:
    page = open_page(width, scheme)
    page.locator(f"#job-{done} figcaption").wait_for()
    page.check("#choose-all-jobs")
    page.check("#choose-all-captures")
    page.click(f"#results-{done} summary")
    page.fill("#search", pair[0].id[1:9])
    expect(page.locator("#found")).to_contain_text("Found")
    fits = "document.documentElement.scrollWidth"
    assert page.evaluate(fits) == width
    for opener in ("#batch-captures", "#delete-jobs"):
        page.click(opener)
        assert page.evaluate(fits) == width
        assert page.evaluate("(d => d.scrollWidth - d.clientWidth)(document.querySelector('dialog'))") == 0
        page.click("#dialog-back")
    controls = "button, a[href], input, select, textarea"
    unnamed = page.evaluate(
        """(which) => [...document.querySelectorAll(which)].filter(
            (one) => !(one.textContent.trim() || one.ariaLabel || one.labels?.length || one.querySelector('img[alt]'))
        ).map((one) => one.outerHTML)""",
        controls,
    )
    assert unnamed == []
    assert seen.faults == []
