"""Clients that start, save, stop and finalise captures while the service is disturbed."""

from __future__ import annotations

import json
import random
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from maintenance.patient_client import PatientClient

from rigs.toml import catalog_rig, dump_rig

RIGS = ("left", "right")
_CAMERAS, _SIZE = 3, "ci3x3"
_DEVICES = "mock:fan_and_ball?samples=1&truth_every=1000000"
_TICKS = (40, 400, 2000)
_PRE_TRIGGER_MS = 5.0
_ENDED = ("done", "failed", "cancelled")


@dataclass
class Asked:
    """A capture as its client knows it: the request, and the orders that were given, whether or not they were taken."""

    request: dict[str, Any]
    rig: str
    stopped: bool = False
    saved: bool = False
    due: list[tuple[float, str]] = field(default_factory=list)


def rig_variables(folder: Path) -> dict[str, str]:
    """Write rigs of three small simulated cameras into `folder`; return the variables that make them a service's."""
    sources = {}
    for name in RIGS:
        rig = catalog_rig(_SIZE)
        path = folder / f"{name}.toml"
        path.write_text(dump_rig(replace(rig, name=name, cameras=rig.cameras[:_CAMERAS])))
        sources[name] = {"rig": str(path), "devices": _DEVICES}
    return {"SPIKE4DGS_RIGS": json.dumps(sources), "SPIKE4DGS_LOCKS": str(folder), "BENCH_RECORDER": "real"}


class CaptureClients:
    """Makes `number` captures, one at a time on each rig; `asked` has them by id, once they were accepted."""

    def __init__(self, client: PatientClient, number: int, rng: random.Random) -> None:
        self._client = client
        self._number = number
        self._rng = rng
        self._open: dict[str, str] = {}  # the capture that each rig is at
        self._drawn: dict[str, Asked] = {}  # refused until now, as the rig was busy
        self._keys = 0
        self.asked: dict[str, Asked] = {}
        self.acts = {"stop": 0, "save": 0, "finalise": 0}

    def first(self) -> str:
        """Make the first capture, before anything is disturbed; return its id."""
        self._keys = 1
        self._drawn[RIGS[0]] = Asked({"name": "first", "ticks": _TICKS[0]}, RIGS[0])
        self._begin(RIGS[0])
        (capture_id,) = self.asked
        while self._shown(capture_id)["status"] != "done":
            time.sleep(0.2)
        del self._open[RIGS[0]]
        return capture_id

    def act(self) -> bool:
        """Give the orders that are due and begin what can be; return whether all captures have ended, whole or said."""
        for rig in RIGS:
            if rig in self._open:
                self._order(self._open[rig])
                if self._shown(self._open[rig])["status"] in _ENDED:
                    del self._open[rig]
            elif rig in self._drawn or self._keys < self._number:
                self._begin(rig)
        for capture in self._client.ask("GET", "/captures?status=failed&limit=100").json()["items"]:
            if capture["partial_planes"] and self._rng.random() < 0.3:
                self.acts["finalise"] += self._client.told(f"/captures/{capture['id']}/finalise")
        return len(self.asked) == self._number and self._settled()

    def _settled(self) -> bool:
        """Return whether every capture has ended, and no failed one has planes that can be finalised."""
        shown = self._client.ask("GET", "/captures?limit=1000").json()["items"]
        return all(one["status"] in _ENDED and not one["partial_planes"] for one in shown)

    def _begin(self, rig: str) -> None:
        if rig not in self._drawn:
            self._drawn[rig] = self._draw(rig)
            self._keys += 1
        asked = self._drawn[rig]
        answer = self._client.ask("POST", f"/rigs/{rig}/captures", asked.request, asked.request["name"])
        if answer.status_code == 409:  # somebody is not finished with the rig
            return
        capture_id = answer.raise_for_status().json()["id"]
        now = time.monotonic()
        asked.due = [(now + after_s, word) for after_s, word in asked.due]
        self.asked[capture_id] = self._drawn.pop(rig)
        self._open[rig] = capture_id

    def _draw(self, rig: str) -> Asked:
        """Draw a capture: of a fixed length, until it is stopped, or behind a pre-trigger."""
        kind = self._rng.choice(("ticks", "stopped", "stopped", "pre_trigger"))
        request: dict[str, Any] = {"name": f"capture-{self._keys}"}
        at_s = self._rng.uniform(0.0, 4.0)
        if kind == "ticks":
            asked = Asked(request | {"ticks": self._rng.choice(_TICKS)}, rig)
            asked.due = [(at_s, "stop")] if self._rng.random() < 0.2 else []
            return asked
        asked = Asked(request | {"until_stopped": True}, rig, due=[(at_s, "stop")])
        if kind == "pre_trigger":
            asked.request["pre_trigger_ms"] = _PRE_TRIGGER_MS
            asked.due.insert(0, (self._rng.uniform(0.0, 4.0), "save"))
        return asked

    def _order(self, capture_id: str) -> None:
        asked = self.asked[capture_id]
        for when, word in [due for due in asked.due if due[0] <= time.monotonic()]:
            asked.due.remove((when, word))
            asked.stopped |= word == "stop"  # before it is sent: it may be taken and its answer lost
            asked.saved |= word == "save"
            self.acts[word] += self._client.told(f"/rigs/{asked.rig}/captures/{capture_id}/{word}")

    def _shown(self, capture_id: str) -> dict[str, Any]:
        return self._client.ask("GET", f"/captures/{capture_id}").raise_for_status().json()
