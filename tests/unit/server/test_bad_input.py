"""A failure that comes again is told from one that may pass, and is told in the words of a request."""

import asyncio
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from acquisition.errors import BadRecordingError, DeviceError, DiskError, RigBusyError
from reconstruction.errors import BadRunError, GeometryError
from reconstruction.pipeline.budget import StoppedError
from rigs.errors import RigError, Spike4dgsError
from server.app import create_app
from server.settings import ServiceSettings
from server.store.tables import Entry
from server.work.reporter import Reporter
from server.work.supervisor import BadInputError, StageError, supervise
from server.work.wording import in_request_words

LASTING = [BadRecordingError("x"), BadRunError("x"), GeometryError("x"), RigError("x"), BadInputError("x")]
PASSING = [DeviceError("x"), DiskError("x"), RigBusyError("x"), StoppedError("x"), StageError("x"), OSError("x")]


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as client:
        yield client


def failed(http: TestClient, error: Exception, told: str = "failed") -> dict:
    """Return a job that ended with an error, as REST shows it alone; it is listed as the same."""
    store = http.app.state.services.store  # type: ignore[attr-defined]
    asked = {"type": "verify", "capture": "c"}
    entry = Entry(store.entries.dated_id("j"), "job", "verify", store.entries.now(), asked, queue="tasks", told=told)
    store.entries.add(entry)
    Reporter(store, entry.id, "verify").close(error)
    (listed,) = http.get("/v1/jobs", params={"q": entry.id}).json()["items"]
    assert listed == http.get(f"/v1/jobs/{entry.id}").json()
    return listed


@pytest.mark.parametrize("error", LASTING, ids=lambda error: type(error).__name__)
def test_what_was_refused_for_its_input_is_not_to_be_resumed(http: TestClient, error: Exception) -> None:
    job = failed(http, error)
    assert (job["status"], job["bad_input"], job["resumable"]) == ("failed", True, False)


@pytest.mark.parametrize("error", PASSING, ids=lambda error: type(error).__name__)
def test_what_may_pass_is_resumable(http: TestClient, error: Exception) -> None:
    job = failed(http, error)
    assert (job["bad_input"], job["resumable"]) == (False, True)


def test_a_cancelled_job_is_resumable_and_a_finished_one_is_not(http: TestClient) -> None:
    assert failed(http, BadRunError("x"), "cancelled")["resumable"]
    assert not failed(http, BadRunError("x"), "done")["resumable"]


@pytest.mark.parametrize(
    ("code", "kind"),
    [
        ('print(json.dumps({**error, "bad_input": True}), file=sys.stderr); sys.exit(1)', BadInputError),
        ('print(json.dumps({**error, "bad_input": False}), file=sys.stderr); sys.exit(2)', StageError),
        ("print(json.dumps(error), file=sys.stderr); sys.exit(1)", StageError),  # of an older worker
        ('print("Error: no such option", file=sys.stderr); sys.exit(2)', BadInputError),
        ('print("broke", file=sys.stderr); sys.exit(1)', StageError),
    ],
)
def test_a_stage_tells_its_supervisor(tmp_path: Path, code: str, kind: type[StageError]) -> None:
    parts = {"event": "error", "found": "found a", "expected": "b", "do": "c", "where": "", "exit_code": 1}
    command = [sys.executable, "-c", f"import json, sys\nerror = {parts}\n{code}"]
    with pytest.raises(StageError) as caught:
        asyncio.run(supervise(command, folders=[], log=tmp_path / "log", on_progress=print, grace_s=1))
    assert type(caught.value) is kind


@pytest.mark.parametrize(
    ("arguments", "lasts"), [(["verify", "/nowhere"], True), (["export", "/", "--out", "/proc/x/y"], True)]
)
def test_a_command_tells_what_its_error_is_about(arguments: list[str], lasts: bool) -> None:
    command = [sys.executable, "-m", "server.cli", *arguments, *(["--format", "ply"] if "export" in arguments else [])]
    done = subprocess.run(command, env={"SPIKE4DGS_PROGRESS": "json"}, capture_output=True, text=True, check=False)
    event = next(json.loads(line) for line in done.stderr.splitlines() if line.startswith("{"))
    assert event["bad_input"] is lasts


def test_an_error_carries_its_kind() -> None:
    assert not Spike4dgsError("x").bad_input
    assert BadRunError.at("here", OSError("gone")).bad_input


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        (
            "found the instant 3 s, expected 0 to 1; change --at",
            "found the instant 3 s, expected 0 to 1; change `at_s`",
        ),
        ("import with the other --row-order", "import with the other `row_order`"),
        ("found --refine on with --model stg", "found `refine` on with `model` stg"),
        ("Error: Invalid value for '--holdout': x", "Invalid value for `holdout`: x"),
        ("exists already; choose another --out", "exists already; choose another folder"),
        ("its --size WxH and --tick-rate HZ", "its `size` WxH and `tick_rate_hz` HZ"),
        ("`spike4dgs calibrate --pixels` makes them", "`spike4dgs calibrate --pixels` makes them"),
        ("a -- b, x--y and -3", "a -- b, x--y and -3"),
    ],
)
def test_options_are_told_as_fields(http: TestClient, said: str, shown: str) -> None:
    assert in_request_words(said) == shown
    assert failed(http, StageError(said))["error"] == shown


def test_a_job_that_is_queued_again_tells_no_error_of_the_attempt_before(http: TestClient) -> None:
    services = http.app.state.services  # type: ignore[attr-defined]
    job = failed(http, BadRunError("found a fault"))
    assert job["error"] == "found a fault"
    for status, do in (("queued", "resume"), ("cancelled", "cancel")):
        assert http.post(f"/v1/jobs/{job['id']}/{do}").is_success
        shown = http.get(f"/v1/jobs/{job['id']}").json()
        assert (shown["status"], shown["error"], shown["bad_input"]) == (status, None, False)
        (listed,) = http.get("/v1/jobs", params={"q": job["id"]}).json()["items"]
        assert (listed["status"], listed["error"], listed["bad_input"]) == (status, None, False)
    services.announcer.look()
    told = [event.data for event in services.store.events.after(0, job["id"]) if event.kind == "status"]
    assert told[-1] == {"status": "cancelled", "error": None}


def test_a_job_that_is_done_again_from_a_stage_is_no_further(http: TestClient) -> None:
    store = http.app.state.services.store  # type: ignore[attr-defined]
    asked = {"type": "reconstruct", "capture": "c"}
    made = {"stage": "report", "fraction": 1.0, "message": "scored", "warnings": ["dark"]}
    places = {"queue": "reconstructions", "told": "done", "progress": made}
    entry = Entry(store.entries.dated_id("j"), "job", "reconstruct", store.entries.now(), asked, **places)
    store.entries.add(entry)
    again = http.post(f"/v1/jobs/{entry.id}/restart", json={"stage": "points"}).json()
    shown = [again[name] for name in ("status", "stage", "fraction", "message", "warnings")]
    assert shown == ["queued", "points", 0.0, "", []]
    steps = http.get(f"/v1/jobs/{entry.id}/steps").json()["items"]
    assert [step["status"] for step in steps] == ["done"] * 3 + ["waiting"] * 3
