"""Measures a service under many clients: each asks once a second for a while, on loopback only, and stops by itself.

`make load` runs it with 200 clients for a minute, beside 1000 queued jobs.

A client draws what it asks for: a page of jobs, a job, a file to download, or the events of a job that has ended, as a
stream (SSE). Every tenth also listens to the stream of all events. A stage keeps one core busy all the while.
"""

from __future__ import annotations

import asyncio
import json
import os
import random
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import click
import httpx
from maintenance.deployment import Deployment

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from server.client import RefusedError, ServiceClient
from server.errors import ServiceError
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest

_BATCH = 250
_READY_S = 120.0
_ANSWER_S = 30.0
_LISTINGS = 21  # of all jobs, before the clients come
_STEP_S = 0.25  # a job takes 35 of them
Answer = tuple[str, int, float]  # kind, status (0: none), seconds


def _http(address: str) -> httpx.AsyncClient:
    return httpx.AsyncClient(base_url=address, timeout=_ANSWER_S, trust_env=False, verify=False)


async def _client(address: str, paths: dict[str, str], until: float, rng: random.Random) -> list[Answer]:
    """One client: a request a second, of a kind drawn at random, until a time on the monotonic clock."""
    answers: list[Answer] = []
    await asyncio.sleep(rng.random())
    async with _http(address) as http:
        while (began := time.monotonic()) < until:
            kind = rng.choice(list(paths))
            try:
                status = (await http.get(paths[kind])).status_code
            except httpx.HTTPError:
                status = 0
            took_s = time.monotonic() - began
            answers.append((kind, status, took_s))
            await asyncio.sleep(max(0.0, 1.0 - took_s))
    return answers


async def _listener(address: str, until: float) -> list[Answer]:
    """One stream of all events, to the same end: how soon it began, and how old each event was when it came."""
    answers: list[Answer] = []
    began = time.monotonic()
    try:
        async with asyncio.timeout(until - began), _http(address) as http, http.stream("GET", "/v1/events") as stream:
            answers.append(("stream", stream.status_code, time.monotonic() - began))
            async for line in stream.aiter_lines():
                if line.startswith("data:"):
                    answers.append(("event", 200, time.time() - json.loads(line[5:])["at"]))
    except TimeoutError:
        return answers
    except httpx.HTTPError:
        pass
    return [*answers, ("stream", 0, time.monotonic() - began)]  # it ended too soon


async def measure(address: str, paths: dict[str, str], clients: int, seconds: float) -> list[Answer]:
    """The answers that `clients` clients got in `seconds`; `paths` by kind."""
    until = time.monotonic() + seconds
    work = [_client(address, paths, until, random.Random(n)) for n in range(clients)]
    work += [_listener(address, until) for _ in range(0, clients, 10)]
    async with asyncio.timeout(seconds + 2 * _ANSWER_S):
        return [answer for part in await asyncio.gather(*work) for answer in part]


def summarise(answers: Sequence[Answer]) -> tuple[list[dict], dict[str, float]]:
    """A row a kind, and the named figures; times in ms."""
    rows = []
    asked = [answer for answer in answers if answer[0] != "event"]
    summary = {"requests": float(len(asked)), "events": float(len(answers) - len(asked))}
    for kind in sorted({answer[0] for answer in answers}):
        times = sorted(took_s * 1e3 for name, _, took_s in answers if name == kind)
        row = {"kind": kind, "number": len(times)}
        for percent in (50, 95, 99):
            row[f"p{percent}_ms"] = round(times[min(len(times) - 1, len(times) * percent // 100)], 2)
        summary[f"{kind}.p99_ms"] = row["p99_ms"]
        rows.append(row | {"most_ms": round(times[-1], 2)})
    for status in sorted({answer[1] for answer in asked}):
        summary[f"answers.{status}"] = float(sum(answer[1] == status for answer in asked))
    return rows, summary


def run_load(data: Path, clients: int, seconds: float, jobs: int, step_s: float = _STEP_S) -> BenchDocument:
    """Load on a fresh service over an empty `data` folder while a stage of it burns a core."""
    load = os.getloadavg()[0]
    many = str(1000 * clients)  # all clients share an address, and with it what one client may ask for
    environment = {"BENCH_BURN": "1", "SPIKE4DGS_READ_RATE": many, "SPIKE4DGS_READ_BURST": many}
    deployment = Deployment(data, postgresql=False, step_s=step_s, environment=environment)
    try:
        deployment.start("api")
        deployment.start("a")
        with ServiceClient.at(deployment.address) as client:
            first = _fill(client, jobs)
            alone = sorted(_listing_s(client, jobs) for _ in range(_LISTINGS))
        paths = {
            "listing": "/v1/jobs",
            "job": f"/v1/jobs/{first}",
            "download": f"/v1/jobs/{first}/artefacts/report.html",
            "sse": f"/v1/jobs/{first}/events",
        }
        before_s = _cpu_s(deployment.processes["api"].pid)
        rows, summary = summarise(asyncio.run(measure(deployment.address, paths, clients, seconds)))
        summary["web_process_cores"] = (_cpu_s(deployment.processes["api"].pid) - before_s) / seconds
    finally:
        deployment.close()
    summary |= {"clients": float(clients), "seconds": seconds, "jobs": float(jobs)}
    summary |= {"listing_1000_ms": alone[_LISTINGS // 2] * 1e3, "listing_1000_most_ms": alone[-1] * 1e3}
    summary |= {"load_average.before": load, "load_average.after": os.getloadavg()[0]}
    return BenchDocument("service_load", rows=rows, summary=summary)


def _fill(client: ServiceClient, jobs: int) -> str:
    """Do one job, then queue `jobs` more, no two alike; the id of the first."""
    _wait(lambda: client.checks()["worker"].ok)
    made = client.start_capture("lab3x3", CaptureRequest(ticks=5))
    _wait(lambda: client.capture(made.id).status == "done")
    first = client.submit(ReconstructRequest(capture=made.id)).id
    _wait(lambda: client.job(first).status == "done")
    asked = [ReconstructRequest(capture=made.id, seed=number, name=f"job {number}") for number in range(jobs)]
    for begin in range(0, jobs, _BATCH):
        client.submit_all(asked[begin : begin + _BATCH])
    return first


def _listing_s(client: ServiceClient, jobs: int) -> float:
    """Seconds until a page of up to a thousand jobs is here."""
    began = time.perf_counter()
    answer = client._checked(client._http.get("/v1/jobs", params={"limit": 1000}))
    took_s = time.perf_counter() - began
    found = len(answer.json()["items"])
    if found < min(jobs, 1000):
        raise ServiceError(f"found {found} jobs listed", f"{min(jobs, 1000)}")
    return took_s


def _cpu_s(pid: int) -> float:
    """Processor seconds of a process, in user and system mode."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _wait(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _READY_S
    while time.monotonic() < deadline:
        try:
            if condition():
                return
        except (httpx.TransportError, RefusedError):
            pass
        time.sleep(0.1)
    raise ServiceError(f"found the service not ready after {_READY_S:g} s", "it ready")


@click.command()
@click.option("--clients", type=click.IntRange(1, 500), default=200, show_default=True)
@click.option("--seconds", type=click.FloatRange(1, 600), default=60.0, show_default=True)
@click.option("--jobs", type=click.IntRange(1, 5000), default=1000, show_default=True)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(clients: int, seconds: float, jobs: int, out: Path) -> None:
    """Measure once and write the figures."""
    with tempfile.TemporaryDirectory(prefix="spike4dgs-load-") as folder:
        document = run_load(Path(folder) / "data", clients, seconds, jobs)
    write_json(out, document.to_json())
    for name, value in document.summary.items():
        click.echo(f"{name:24} {value:g}")


if __name__ == "__main__":
    main()
