"""Kills parts of a running service at random while clients use it, and counts what is lost, repeated or left behind.

`make faults` runs it on both databases; `--database` chooses one of them.
"""

from __future__ import annotations

import os
import random
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import click
import httpx
from maintenance.deployment import Deployment
from maintenance.verdict import STAGES, read_trace, torn

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from server.client import ServiceClient
from server.errors import ServiceError

_PATIENCE_S = 120.0
_WORKERS = ("a", "b")
_AGAIN = (409, 503)
DATABASES = ("sqlite", "postgres")


class Client:
    """A client that asks again, with the same key, until it is answered."""

    def __init__(self, address: str) -> None:
        self._http = httpx.Client(base_url=address, timeout=30, trust_env=False)
        self.unanswered = 0
        self.codes: dict[int, int] = {}

    def ask(self, method: str, path: str, body: object = None, key: str | None = None) -> httpx.Response:
        """The first answer that is no 503; raises ServiceError after two minutes without."""
        headers = {} if key is None else {"Idempotency-Key": key}
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            try:
                answer = self._http.request(method, f"/v1{path}", json=body, headers=headers)
            except httpx.TransportError:
                self.unanswered += 1
            else:
                self.codes[answer.status_code] = self.codes.get(answer.status_code, 0) + 1
                if answer.status_code != 503:
                    return answer
            time.sleep(0.2)
        raise ServiceError(f"found no answer for {_PATIENCE_S:g} s", "one", where=f"{method} {path}")

    def probe(self) -> None:
        """Ask once, whatever the answer."""
        try:
            answer = self._http.get("/v1/jobs")
        except httpx.TransportError:
            self.unanswered += 1
        else:
            self.codes[answer.status_code] = self.codes.get(answer.status_code, 0) + 1

    def close(self) -> None:
        """Let go of the connections."""
        self._http.close()


class Campaign:
    """One run: `jobs` jobs, about as many faults, drawn from `rng`."""

    def __init__(self, deployment: Deployment, jobs: int, rng: random.Random) -> None:
        self._deployment = deployment
        self._rng = rng
        self._jobs = jobs
        self._client = Client(deployment.address)
        self._due: list[tuple[float, str]] = []  # when which process is started again
        self.kills = {"api": 0, "worker": 0, "stage": 0, "postgresql": 0}
        self.acts = {"cancel": 0, "resume": 0, "restart": 0}
        self.ended_alone: list[str] = []
        self.accepted: list[str] = []

    def run(self, limit_s: float) -> None:
        """Submit, disturb, and wait until all is done; raises ServiceError after `limit_s`."""
        for name in ("api", *_WORKERS):
            self._deployment.start(name)
        capture = self._client.ask("POST", "/rigs/lab3x3/captures", {"ticks": 5}, "capture").json()["id"]
        while self._client.ask("GET", f"/captures/{capture}").json()["status"] != "done":
            time.sleep(0.2)
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            if len(self.accepted) < self._jobs:
                answer = self._client.ask("POST", "/jobs", {"capture": capture}, f"job-{len(self.accepted)}")
                self.accepted.append(answer.raise_for_status().json()["id"])
            self._revive()
            faults = sum(self.kills.values())
            if faults < self._jobs and self._rng.random() < 0.3:
                self._kill(self._rng.choice(list(self.kills)))
            if self._act(disturb=faults < self._jobs) and faults >= self._jobs and len(self.accepted) == self._jobs:
                return
            time.sleep(self._rng.uniform(0.0, 0.6))
        raise ServiceError(f"found jobs unfinished after {limit_s:g} s", "all done")

    def _revive(self) -> None:
        now = time.monotonic()
        for when, name in [due for due in self._due if due[0] <= now]:
            self._due.remove((when, name))
            if name == "postgresql" and self._deployment.database is not None:
                self._deployment.database.start()
            else:
                self._deployment.start(name)
        for name in self._deployment.dead():
            self.ended_alone.append(f"{name} ended alone: {self._deployment.last_words(name)}")
            self._deployment.start(name)

    def _kill(self, target: str) -> None:
        """kill -9; workers stay away for up to twice the time after which they are taken for dead."""
        if target == "stage":
            pids = self._deployment.stages()
            if not pids:
                return
            os.kill(self._rng.choice(pids), signal.SIGKILL)
        elif target == "postgresql":
            if self._deployment.database is None or any(name == target for _, name in self._due):
                return
            self._deployment.database.kill()
            self._due.append((time.monotonic() + self._rng.uniform(0, 3), target))
            self.kills[target] += 1
            self._revive()
            while any(name == target for _, name in self._due):
                self._client.probe()
                time.sleep(0.2)
                self._revive()
            return
        else:
            name = "api" if target == "api" else self._rng.choice(_WORKERS)
            if name not in self._deployment.processes:
                return
            self._deployment.kill(name)
            away_s = self._rng.uniform(0, 1) if name == "api" else self._rng.choice((0.0, 2.0, 10.0))
            self._due.append((time.monotonic() + away_s, name))
            while name == "api" and any(due == name for _, due in self._due):
                time.sleep(0.1)
                self._revive()
        self.kills[target] += 1

    def _act(self, *, disturb: bool) -> bool:
        """Resume what has failed, and now and then cancel or restart something; whether everything is done."""
        jobs = self._client.ask("GET", "/jobs?limit=1000").json()["items"]
        for job in jobs:
            if job["status"] in ("failed", "cancelled") and self._rng.random() < 0.5:
                self._told("resume", job["id"])
        if disturb and jobs and self._rng.random() < 0.3:
            job = self._rng.choice(jobs)
            if job["status"] in ("queued", "running"):
                self._told("cancel", job["id"])
            elif job["status"] == "done":
                self._told("restart", job["id"], {"stage": self._rng.choice(STAGES)})
        return bool(jobs) and all(job["status"] == "done" for job in jobs)

    def _told(self, word: str, job_id: str, body: object = None) -> None:
        answer = self._client.ask("POST", f"/jobs/{job_id}/{word}", body)
        self.acts[word] += answer.is_success
        if answer.is_error and answer.status_code not in _AGAIN:
            raise ServiceError(
                f"found {answer.status_code} {answer.text[:200]}", "202 or 409", where=f"{word} {job_id}"
            )

    def judge(self) -> tuple[list[dict[str, Any]], dict[str, float]]:
        """A row a job, and the counts; the workers are stopped in between, so that what is left has no excuse."""
        with ServiceClient.at(self._deployment.address) as client:
            known = {job.id: job for job in client.jobs(limit=1000)}
            artefacts = {job_id: client.artefacts(job_id) for job_id in known}
        codes = dict(self._client.codes)
        self._client.close()
        self._deployment.stop()
        time.sleep(0.5)
        rows = []
        for job_id in self.accepted:
            folder = self._deployment.data / "jobs" / job_id
            status = known[job_id].status if job_id in known else "lost"
            rows.append(
                {"job": job_id, "status": status, **read_trace(folder), "torn": torn(folder, artefacts.get(job_id, []))}
            )
        return rows, {
            "jobs": float(len(self.accepted)),
            "lost": float(sum(row["status"] == "lost" for row in rows) + len(set(known) - set(self.accepted))),
            "undone": float(sum(row["status"] != "done" or row["missing"] > 0 for row in rows)),
            "repeated": float(sum(row["repeated"] for row in rows)),
            "reopened": float(sum(row["reopened"] for row in rows)),
            "torn": float(sum(len(row["torn"]) for row in rows)),
            "orphans": float(len(self._deployment.family())),
            "locked": float(len(self._deployment.locked())),
            "ended_alone": float(len(self.ended_alone)),
            "unanswered": float(self._client.unanswered),
            **{f"kills.{name}": float(count) for name, count in self.kills.items()},
            **{f"client.{name}": float(count) for name, count in self.acts.items()},
            **{f"answers.{code}": float(count) for code, count in sorted(codes.items())},
        }


def run_campaign(data: Path, jobs: int, database: str, seed: int, limit_s: float = 1200.0) -> BenchDocument:
    """The counts of one campaign over an empty `data` folder."""
    began = time.monotonic()
    deployment = Deployment(data, postgresql=database == "postgres")
    try:
        campaign = Campaign(deployment, jobs, random.Random(seed))
        campaign.run(limit_s)
        rows, summary = campaign.judge()
    finally:
        deployment.close()
    summary |= {"seed": float(seed), "seconds": time.monotonic() - began}
    summary = {f"{database}.{name}": n for name, n in summary.items()}
    return BenchDocument("faults", [{"database": database} | row for row in rows], campaign.ended_alone, summary)


@click.command()
@click.option("--jobs", type=click.IntRange(1, 500), default=50, show_default=True)
@click.option("--database", "databases", type=click.Choice(DATABASES), multiple=True, default=DATABASES)
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True)
def main(jobs: int, databases: tuple[str, ...], seed: int, out: Path) -> None:
    """Run a campaign on each database, one after the other, and write their counts."""
    document = BenchDocument("faults")
    for database in databases:
        with tempfile.TemporaryDirectory(prefix="spike4dgs-faults-") as folder:
            one = run_campaign(Path(folder) / "data", jobs, database, seed)
        document.rows += one.rows
        document.omissions += one.omissions
        document.summary |= one.summary
    write_json(out, document.to_json())
    for name, value in document.summary.items():
        click.echo(f"{name:28} {value:g}")


if __name__ == "__main__":
    main()
