"""Every answer is one that the OpenAPI document describes, whatever is asked; and the job state is plain JSON."""

import json
import sqlite3
import threading
from collections.abc import Iterator
from typing import Any
from zlib import crc32

import pytest
import schemathesis
import uvicorn
from fastapi import FastAPI
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from schemathesis import GenerationMode
from schemathesis.checks import not_a_server_error, positive_data_acceptance
from schemathesis.core.failures import Failure, FailureGroup

from server.app import create_app
from server.cli.serve import listening
from server.engine import capture_queue
from server.schemas.captures import Capture, CaptureRequest, Captures
from server.schemas.job_types import ReconstructRequest
from server.schemas.jobs import Jobs
from server.schemas.progress import Status
from server.services.services import Services
from server.settings import ServiceSettings
from server.store.entries import Filter

LOOPBACK = "http://127.0.0.1"
EXAMPLES = 8


def captures_of(services: Services, status: Status) -> list[Capture]:
    return Captures.model_validate_json(services.captures.page(Filter("capture"), status)).items


def seeded(services: Services) -> tuple[str, str]:
    """A capture and a reconstruction of it, both done, though no worker has run."""
    while (busy := services.engine.active(capture_queue("lab3x3"))) is not None:  # by what was asked for in passing
        _done(services, busy)
    capture_id = services.rigs.start("lab3x3", CaptureRequest(ticks=40, name="seed"))
    _done(services, capture_id)
    job_id = services.jobs.submit([ReconstructRequest(capture=capture_id)])[0]
    _done(services, job_id)
    run = services.store.folder.run(job_id)
    run.mkdir(parents=True)
    (run / "metrics.json").write_text("{}")
    services.store.artefacts.catalogue(job_id, run, iter(["metrics.json"]))
    services.store.folder.recording(capture_id).mkdir()
    return capture_id, job_id


def _done(services: Services, entry_id: str) -> None:
    with sqlite3.connect(services.settings.data / "dbos.sqlite") as connection:
        connection.execute("UPDATE workflow_status SET status='SUCCESS' WHERE workflow_uuid=?", (entry_id,))


@pytest.fixture(scope="module")
def app(tmp_path_factory) -> FastAPI:
    rates = {"read_burst": 10**6, "write_burst": 10**6}
    return create_app(ServiceSettings(data=tmp_path_factory.mktemp("contract"), **rates))


@pytest.fixture(scope="module")
def address(app) -> Iterator[str]:
    """The service behind a real server, so that what the server itself refuses is seen too."""
    with listening("127.0.0.1", 0) as listener:
        server = uvicorn.Server(uvicorn.Config(app, log_level="error"))
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def schema(app):
    found = schemathesis.openapi.from_dict(app.openapi())
    return found.include(func=lambda context: "text/event-stream" not in json.dumps(context.operation.definition.raw))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the tools that ask
@pytest.mark.parametrize("mode", [GenerationMode.POSITIVE, GenerationMode.NEGATIVE], ids=lambda mode: mode.value)
def test_answers_are_as_described(schema, app, address: str, mode: GenerationMode) -> None:
    faults, asked = {}, 0
    for found in schema.get_all_operations():
        operation = found.ok()

        @settings(
            max_examples=EXAMPLES, derandomize=True, deadline=None, database=None, suppress_health_check=[*HealthCheck]
        )
        @given(case=operation.as_strategy(generation_mode=mode))
        def ask(case) -> None:
            nonlocal asked
            asked += 1
            _aim(case, app.state.services)
            answer = case.call(base_url=address)
            # Whether a request that fits the schema fits what is there, too, no schema can say; 503 is no worker's.
            case.validate_response(answer, excluded_checks=[positive_data_acceptance, not_a_server_error])
            assert answer.status_code < 500 or (case.path, answer.status_code) == ("/v1/readyz", 503)

        try:
            ask()
        except (FailureGroup, Failure) as error:
            faults[operation.label] = "\n".join(str(one) for one in getattr(error, "exceptions", [error]))
        except Unsatisfiable:  # nothing to get wrong
            assert mode is GenerationMode.NEGATIVE
    assert faults == {}, "\n\n".join(f"{label}: {fault}" for label, fault in faults.items())
    assert asked > 100


def _aim(case: Any, services: Services) -> None:
    """Two of three requests are about what is there, which a request before may have deleted."""
    if case.path_parameters and crc32(json.dumps(case.path_parameters, sort_keys=True, default=str).encode()) % 3:
        captures = captures_of(services, "done")
        jobs = Jobs.model_validate_json(services.jobs.page(Filter("job"), "done", 1)).items
        known = (captures[0].id, jobs[0].id) if captures and jobs else seeded(services)
        there = dict(zip(("capture_id", "job_id"), known, strict=True)) | {"rig_id": "lab3x3", "name": "metrics.json"}
        case.path_parameters.update({name: there[name] for name in case.path_parameters if name in there})
