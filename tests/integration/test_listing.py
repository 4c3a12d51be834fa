"""Lists are put together from what is kept: they say of every entry just what is said of it alone."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from server.app import create_app
from server.schemas.captures import Capture
from server.schemas.job_types import JOB_TYPES, RIG_JOB_TYPES
from server.schemas.jobs import Job
from server.schemas.progress import Progress
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.entries import Filter
from server.store.tables import Entry, entries

CAPTURE = "c20260101-000000-00000001"
RUN = "j20260101-000000-00000001"
ASKED = {
    "reconstruct": [
        {"capture": CAPTURE},
        {
            "capture": CAPTURE,
            "images": "tvs",
            "holdout": "cam11",
            "views": ["cam00", "cam01"],
            "budget_s": 300,
            "seed": 0,
        },
    ],
    "images": [{"capture": CAPTURE, "method": "tfi", "ticks": "0:400:20"}],
    "calibrate": [
        {"capture": CAPTURE, "board": "charuco:6x4:100:67.5:DICT_4X4_50"},
        {"capture": CAPTURE, "dark": "c20260101-000000-00000002", "rig": "lab3x3", "apply": True},
    ],
    "check-rig": [{"capture": CAPTURE, "rig": "lab3x3"}],
    "verify": [{"capture": CAPTURE}],
    "evaluate": [{"job": RUN}],
    "render": [{"job": RUN, "cameras": "u20260101-000000-00000001"}],
    "export": [{"job": RUN, "format": "spz", "at_s": 1e-7, "camera": "cam11"}],
    "preflight": [{"disk_seconds": 0.1}],
    "look": [{"ticks": 7}],
}
FAR = Progress(stage="train", fraction=1 / 3, message="Ünï\u2603 \"'\\", seconds={"plan": 0.1, "train": 1e-9})


@pytest.fixture
def http(tmp_path: Path) -> Iterator[TestClient]:
    settings = ServiceSettings(data=tmp_path, locks=tmp_path / "locks")
    with TestClient(create_app(settings), base_url="http://127.0.0.1") as client:
        yield client


@pytest.fixture
def services(http: TestClient) -> Services:
    return http.app.state.services  # type: ignore[attr-defined]


def add(services: Services, number: int, kind: str, entry_type: str, request: dict, **more: object) -> str:
    entry_id = f"{kind[0]}20260101-000000-{number:08x}"
    entry = Entry(entry_id, kind, entry_type, "2026-01-01T00:00:00.000+00:00", request, **more)  # type: ignore[arg-type]
    services.store.entries.add(entry)
    return entry_id


@pytest.mark.parametrize("kind", [*JOB_TYPES, *RIG_JOB_TYPES])
def test_a_listed_job_is_the_job(http: TestClient, services: Services, kind: str) -> None:
    model = (JOB_TYPES | RIG_JOB_TYPES)[kind]
    requests = [model.model_validate(asked | {"type": kind}) for asked in ASKED[kind]]
    for number, kept in enumerate(request.model_dump(exclude={"name", "priority"}) for request in requests):
        more = {"rig": "lab3x3", "name": 'a "name" of Ünï', "priority": 7} if number else {}
        progress = FAR.model_dump() if number else {}
        add(services, number, "job", kind, kept, progress=progress, **more)
    kept = requests[0].model_dump(exclude={"name", "priority"})
    add(services, 9, "job", kind, kept, queue="tasks", progress=FAR.model_dump() | {"error": "broke"})
    services.announcer.look()  # it has a place in the queue from here on
    listed = http.get("/v1/jobs").json()["items"]
    assert len(listed) == len(ASKED[kind]) + 1
    for one in listed:
        assert one == http.get(f"/v1/jobs/{one['id']}").json()
        assert one == json.loads(Job.model_validate(one).model_dump_json())


def test_what_was_kept_before_a_field_was_added_is_listed(http: TestClient, services: Services) -> None:
    job = add(services, 1, "job", "reconstruct", {"capture": CAPTURE}, progress={"stage": "train"})
    (listed,) = http.get("/v1/jobs").json()["items"]
    assert listed == http.get(f"/v1/jobs/{job}").json()
    assert (listed["request"]["model"], listed["fraction"]) == ("auto", 0.0)


def test_a_listed_capture_is_the_capture(http: TestClient, services: Services) -> None:
    add(services, 1, "capture", "record", {"ticks": 40}, rig="lab3x3", progress=FAR.model_dump())
    add(services, 2, "capture", "record", {"until_stopped": True, "ticks": None}, queue="captures-lab3x3", name="Ünï")
    add(services, 3, "capture", "import", {"uploads": ["u1"]})
    listed = http.get("/v1/captures").json()["items"]
    assert [one["ticks"] for one in listed] == [None, None, 40]
    for one in listed:
        assert one == http.get(f"/v1/captures/{one['id']}").json()
        assert one == json.loads(Capture.model_validate(one).model_dump_json())


def test_a_list_is_never_stale(http: TestClient, services: Services) -> None:
    job = add(services, 1, "job", "verify", {"capture": CAPTURE, "type": "verify"}, queue="tasks")
    for fraction in (0.25, 0.5):
        services.store.events.progress(job, Progress(stage="verify", fraction=fraction).model_dump())
        services.store.entries.change(job, priority=int(fraction * 100))
        (listed,) = http.get("/v1/jobs").json()["items"]
        assert (listed["fraction"], listed["priority"], listed["status"]) == (fraction, fraction * 100, "queued")


def test_pages_of_one_status_among_many(http: TestClient, services: Services) -> None:
    """More entries than are looked at together, few of them done."""
    asked = {"capture": CAPTURE, "type": "verify"}
    made = [
        Entry(f"j20260101-000000-{n:08x}", "job", "verify", "2026-01-01", asked, queue="tasks" if n % 100 else None)
        for n in range(1100)
    ]
    with services.store.database.begin() as connection:
        connection.execute(entries.insert(), [vars(one) for one in made])
    done = [one.id for one in made if one.queue is None]
    found, cursor = [], None
    while cursor is not None or not found:
        page = json.loads(services.jobs.page(Filter("job", before=cursor), "done", 4))
        found += [one["id"] for one in page["items"]]
        cursor = page["next"]
    assert found == done[::-1]
