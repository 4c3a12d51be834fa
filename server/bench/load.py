"""How fast a service answers many clients: each asks once a second for a while, on loopback only, and stops by itself.

`python -m server.bench.load --clients 200 --seconds 60 --jobs 1000 --out service_load.json`
"""

from __future__ import annotations

import asyncio
import random
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import click
import httpx

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from server.bench.deployment import Deployment
from server.client import RefusedError, ServiceClient
from server.errors import ServiceError
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest

_BATCH = 250
_READY_S = 120.0
Answer = tuple[str, int, float]  # kind, status (0: none), seconds


async def _client(http: httpx.AsyncClient, paths: dict[str, str], until: float, rng: random.Random) -> list[Answer]:
    """One client: a request a second, of a kind drawn at random, until a time on the monotonic clock."""
    answers: list[Answer] = []
    await asyncio.sleep(rng.random())
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


async def measure(address: str, paths: dict[str, str], clients: int, seconds: float) -> list[Answer]:
    """The answers that `clients` clients got in `seconds`; `paths` by kind."""
    limits = httpx.Limits(max_connections=clients)
    async with httpx.AsyncClient(base_url=address, timeout=30, limits=limits, trust_env=False) as http:
        until = time.monotonic() + seconds
        work = [_client(http, paths, until, random.Random(n)) for n in range(clients)]
        return [answer for part in await asyncio.gather(*work) for answer in part]


def summarise(answers: list[Answer]) -> tuple[list[dict], dict[str, float]]:
    """A row a kind, and the named figures; times in ms."""
    rows = []
    summary = {"requests": float(len(answers))}
    for kind in sorted({answer[0] for answer in answers}):
        times = sorted(took_s * 1e3 for name, _, took_s in answers if name == kind)
        row = {"kind": kind, "requests": len(times)}
        for percent in (50, 95, 99):
            row[f"p{percent}_ms"] = round(times[min(len(times) - 1, len(times) * percent // 100)], 2)
            summary[f"{kind}.p{percent}_ms"] = row[f"p{percent}_ms"]
        rows.append(row)
    for status in {answer[1] for answer in answers}:
        summary[f"answers.{status}"] = float(sum(answer[1] == status for answer in answers))
    return rows, summary


def run_load(data: Path, clients: int, seconds: float, jobs: int) -> BenchDocument:
    """Load on a fresh service over an empty `data` folder while a stage of it runs."""
    deployment = Deployment(data, postgresql=False)
    try:
        deployment.start("api")
        deployment.start("a")
        with ServiceClient.at(deployment.address) as client:
            _wait(lambda: client.checks()["worker"].ok)
            made = client.start_capture("lab3x3", CaptureRequest(ticks=5))
            _wait(lambda: client.capture(made.id).status == "done")
            first = client.submit(ReconstructRequest(capture=made.id)).id
            _wait(lambda: client.job(first).status == "done")
            for begin in range(0, jobs, _BATCH):
                client.submit_all([ReconstructRequest(capture=made.id)] * min(_BATCH, jobs - begin))
            alone = []
            for _ in range(9):
                began = time.perf_counter()
                client._checked(client._http.get("/v1/jobs", params={"limit": 1000}))
                alone.append(time.perf_counter() - began)
        paths = {
            "listing": "/v1/jobs",
            "job": f"/v1/jobs/{first}",
            "artefacts": f"/v1/jobs/{first}/artefacts",
            "download": f"/v1/jobs/{first}/artefacts/report.html",
        }
        rows, summary = summarise(asyncio.run(measure(deployment.address, paths, clients, seconds)))
    finally:
        deployment.close()
    summary |= {"clients": float(clients), "seconds": seconds, "listing_1000_ms": sorted(alone)[4] * 1e3}
    return BenchDocument("service_load", rows=rows, summary=summary, omissions=["job events as a stream (SSE)"])


def _wait(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + _READY_S
    while time.monotonic() < deadline:
        try:
            if condition():
                return
        except (httpx.TransportError, RefusedError):
            pass
        time.sleep(0.1)
    raise ServiceError(f"found the service not ready after {_READY_S:g} s, expected it ready")


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
