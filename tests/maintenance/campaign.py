"""One campaign: clients make captures and jobs while parts of the service are killed; then what is left is judged."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass
from typing import Any

from maintenance.capture_clients import CaptureClients
from maintenance.capture_verdict import Left, judge_captures
from maintenance.deployment import Deployment
from maintenance.killer import WORKERS, Killer
from maintenance.patient_client import PatientClient
from maintenance.verdict import STAGES, judge_jobs

from server.client import ServiceClient
from server.errors import ServiceError

_STRIKES = 0.35  # share of the rounds of its loop in which it kills
_PAUSE_S = 0.4


@dataclass(frozen=True)
class Plan:
    """The amount that a campaign does: it ends when all is done and so much was killed.

    The last of the `kills` is kept for a capture, where none was met before.
    """

    kills: int
    jobs: int
    captures: int


class Campaign:
    """One run of a plan on a deployment whose rigs are those of `capture_clients`; all else is drawn from `rng`."""

    def __init__(self, deployment: Deployment, plan: Plan, rng: random.Random) -> None:
        self._deployment = deployment
        self._plan = plan
        self._rng = rng
        self._client = PatientClient(deployment.address)
        self._captures = CaptureClients(self._client, plan.captures, rng)
        self._killer = Killer(deployment, rng, self._client.probe)
        self._source = ""
        self.acts = {"cancel": 0, "resume": 0, "restart": 0}
        self.accepted: list[str] = []

    @property
    def ended_alone(self) -> list[str]:
        """Return what ended by itself, and with which words."""
        return self._killer.ended_alone

    def run(self, limit_s: float) -> None:
        """Submit, disturb, and wait until all is done; raises ServiceError after `limit_s`."""
        for name in ("api", *WORKERS):
            self._deployment.start(name)
        self._source = self._captures.first()
        settled = False  # whether every capture has ended
        deadline = time.monotonic() + limit_s
        while time.monotonic() < deadline:
            if len(self.accepted) < self._plan.jobs:
                self._submit()
            self._killer.revive()
            kills_left = self._plan.kills - sum(self._killer.kills.values())
            disturbs = kills_left > 0
            if disturbs and self._rng.random() < _STRIKES:
                self._killer.strike(at_capture=kills_left == 1 and not (settled or self._killer.met_a_capture))
            settled = self._captures.act()
            if self._act(disturbs=disturbs) and settled and not disturbs:
                return self._killer.close()
            time.sleep(self._rng.uniform(0.0, _PAUSE_S))
        raise ServiceError(f"found after {limit_s:g} s {self._unfinished()}", "all done", where=self._deployment.data)

    def _submit(self) -> None:
        spans = self._rng.choice((0, 2, 4))  # which the stand-in takes from the seed
        asked = {"capture": self._source, "seed": spans}
        answer = self._client.ask("POST", "/jobs", asked, f"job-{len(self.accepted)}")
        self.accepted.append(answer.raise_for_status().json()["id"])

    def _act(self, *, disturbs: bool) -> bool:
        """Resume what has failed, now and then cancel or restart something; return whether every job is done."""
        jobs = self._client.ask("GET", "/jobs?limit=1000").json()["items"]
        for job in jobs:
            if job["status"] in ("failed", "cancelled") and self._rng.random() < 0.5:
                self._told("resume", job["id"])
        if disturbs and jobs and self._rng.random() < 0.2:
            job = self._rng.choice(jobs)
            if job["status"] in ("queued", "running"):
                self._told("cancel", job["id"])
            elif job["status"] == "done":
                self._told("restart", job["id"], {"stage": self._rng.choice(STAGES)})
        return len(jobs) == self._plan.jobs and all(job["status"] == "done" for job in jobs)

    def _unfinished(self) -> str:
        """Say what is not done, and the last words of it."""
        jobs = self._client.ask("GET", "/jobs?limit=1000").json()["items"]
        captures = self._client.ask("GET", "/captures?limit=1000").json()["items"]
        left = [one for one in jobs if one["status"] != "done"]
        left += [one for one in captures if one["status"] in ("queued", "running") or one["partial_planes"]]
        words = [f"{one['id']} {one['status']} ({one['stage']}: {one['message']})" for one in left]
        made = f"{len(jobs)} jobs, {len(captures)} captures, kills {self._killer.kills}"
        return f"{made}, unfinished: {', '.join(words) or 'none'}"

    def _told(self, word: str, job_id: str, body: object = None) -> None:
        self.acts[word] += self._client.told(f"/jobs/{job_id}/{word}", body)

    def judge(self) -> tuple[list[dict[str, Any]], dict[str, float]]:
        """A row for each job and each capture, and the counts.

        The workers are stopped in between, so that what is left has no excuse.
        """
        with ServiceClient.at(self._deployment.address) as client:
            jobs = {job.id: job for job in client.jobs(limit=1000)}
            artefacts = {job_id: client.artefacts(job_id) for job_id in jobs}
            shown = {one.id: one for one in client.captures(limit=1000)}
        self._client.close()
        self._deployment.stop()
        time.sleep(0.5)
        data, killer = self._deployment.data, self._killer
        rows, counts = judge_jobs(data, self.accepted, jobs, artefacts)
        filmed, film_counts = judge_captures(Left(data, self._captures.asked, shown, killer.kept))
        counts |= {f"captures.{name}": float(count) for name, count in film_counts.items()}
        counts |= {
            "orphans": float(len(self._deployment.family())),
            "locked": float(len(self._deployment.locked())),
            "ended_alone": float(len(killer.ended_alone)),
            "unanswered": float(self._client.unanswered),
            "kills": float(sum(killer.kills.values())),
            **{f"kills.{name}": float(count) for name, count in killer.kills.items()},
            **{f"client.{name}": float(count) for name, count in (self.acts | self._captures.acts).items()},
            **{f"answers.{code}": float(count) for code, count in sorted(self._client.codes.items())},
        }
        return [*rows, *filmed], counts
