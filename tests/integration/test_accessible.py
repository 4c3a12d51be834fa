"""axe-core finds nothing serious in any state of the pages, wide and narrow, light and dark.

To look at a state more, add a line to STATES: a function that opens the page and brings it there. `make axe` writes all
that was found, minor findings too, into tests/benchmarks/axe.json.
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from integration.fake_report import report_page
from maintenance.operator_page import BROWSER, CHROMIUM, LONG_MS, Service

from acquisition.bench_document import BenchDocument
from acquisition.durable import write_json
from server.routes import page as page_routes
from server.schemas.captures import Capture

axe_playwright = pytest.importorskip(
    "axe_playwright_python.sync_playwright", reason="found no axe; install the dev extra"
)
RENDERER = Path(page_routes.__file__).parents[1] / "page/viewer/vendor/spark.js"
pytestmark = BROWSER
SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDTHS = 1280, 400
ALL_RULES = {"resultTypes": ["violations"]}
RULES = {"light": ALL_RULES, "dark": ALL_RULES | {"runOnly": ["cat.color"]}}  # by scheme, which changes colours alone
GRAVE = ("serious", "critical")
TOO_WIDE = """[document.documentElement, ...document.querySelectorAll('dialog')]
  .filter((one) => one.scrollWidth > one.clientWidth).map((one) => one.tagName)"""
NOTHING = {"items": [], "next": None}
Answer = Callable[[Any], Any]


@dataclass
class Stand:
    """Opens pages of a service that has one finished capture and one finished reconstruction.

    `answers`: by an address's pattern, what to make of the service's answer before the page has it.
    """

    service: Service
    browser: Any
    capture: str
    job: str
    contexts: list[Any] = field(default_factory=list)

    def page(
        self, *clicks: str, path: str = "", answers: Mapping[str, Answer] | None = None, wanted: str = "#jobs > li"
    ) -> Any:
        """Open a page, wait until it has `wanted`, and click what is named, one after another."""
        context = self.browser.new_context(viewport={"width": WIDTHS[0], "height": 900})
        context.set_default_timeout(LONG_MS)
        self.contexts.append(context)
        page = context.new_page()
        for pattern, change in (answers or {}).items():
            page.route(re.compile(pattern), self._answering(change))
        page.goto(f"{self.service.address}/{path}")
        page.wait_for_selector(wanted)
        for name in clicks:
            page.click(name)
        return page

    @staticmethod
    def _answering(change: Answer) -> Callable[[Any], None]:
        def answer(route: Any) -> None:
            found = route.fetch()
            route.fulfill(response=found, json=change(found.json()))

        return answer

    def form(self, label: str, card: str) -> Any:
        """Open the dialog of a button on a card, with all its options."""
        page = self.page(f"#more-{self.capture} summary", f"#manage-{self.job} summary")
        page.locator(card).get_by_role("button", name=label).first.click()
        page.wait_for_selector("#dialog[open]")
        for more in page.locator("#dialog summary").all():
            more.click()
        return page

    def searched(self, words: str) -> Any:
        """Open the page and search."""
        page = self.page()
        page.fill("#search", words)
        page.wait_for_selector("#no-jobs")
        return page

    def viewer(self, *clicks: str) -> Any:
        """Open the viewer, and click what is named."""
        if not RENDERER.exists():
            pytest.skip("found no renderer of the viewer; run `make viewer`")
        wanted = "#picture[data-settled=yes]"
        page = self.page(*clicks, path=f"viewer.html?job={self.job}", wanted=wanted)
        page.wait_for_selector(wanted)
        return page


def changed(**members: Any) -> Answer:
    """Return an answer with members in place of its own."""
    return lambda found: found | members


def first(**members: Any) -> Answer:
    """Return a list with another item before its first one, which it is made of."""
    return lambda found: found | {"items": [found["items"][0] | members, *found["items"]]}


def with_faults(manifest: Any) -> Any:
    drops = {layer: 3 for layer in manifest["cameras"][0]["drops"]}
    cameras = [camera | {"drops": drops, "skew_s": 2.5e-6} for camera in manifest["cameras"]]
    verified = {
        "job": "j1",
        "created": "2026-11-23T10:00:00Z",
        "status": "done",
        "sound": False,
        "damages": ["cam11.dat"],
    }
    return manifest | {"cameras": cameras, "reason": "cam02 answered no more", "verified": verified}


def in_every_status(jobs: Any) -> Any:
    """One job a status, made of the finished one; they have its results."""
    one = next(item for item in jobs["items"] if item["status"] == "done")
    more = {
        "queued": {"stage": None, "seconds": {}, "priority": 7},
        "running": {
            "stage": "train",
            "fraction": 0.4,
            "message": "step 3, loss 0.1, PSNR 21.30 dB",
            "seconds": {"plan": 3},
        },
        "failed": {"stage": "points", "error": "points: found a fault, expected none; mend it", "warnings": ["dark"]},
        "cancelled": {"stage": "train"},
        "done": {"warnings": ["cam02 is out of focus"]},
    }
    return jobs | {"items": [one | {"status": status} | changes for status, changes in more.items()]}


def recording(at: Stand) -> Any:
    running = {"id": at.capture.replace("c2", "c3"), "type": "record", "status": "running", "ticks": None}
    running |= {"pre_trigger_ms": 50, "message": "1200 planes", "stage": "record"}
    busy = lambda rigs: {"items": [rig | {"busy": running["id"]} for rig in rigs["items"]]}  # noqa: E731
    return at.page(answers={r"/v1/captures\?": first(**running), r"/v1/rigs$": busy})


def faulty(at: Stand) -> Any:
    lost = {
        "id": at.capture.replace("c2", "c3"),
        "status": "failed",
        "error": "found no answer of cam11",
        "partial_planes": 120,
    }
    return at.page(
        f"#more-{at.capture} summary",
        answers={r"/v1/captures\?": first(**lost), r"/manifest$": with_faults},
        wanted=f"#capture-{at.capture} .failed",
    )


def refused(at: Stand) -> Any:
    """The service asks for a token."""
    context = at.browser.new_context()
    at.contexts.append(context)
    page = context.new_page()
    page.route("**/v1/**", lambda route: route.fulfill(status=401, json={"status": 401, "detail": "found no token"}))
    page.goto(at.service.address)
    page.wait_for_selector("#token-form:not([hidden])")
    return page


def away(at: Stand) -> Any:
    page = at.page()
    page.wait_for_selector("#rigs > li")
    page.route("**/v1/**", lambda route: route.abort())
    page.wait_for_selector("body.away")
    return page


def report(at: Stand) -> Any:
    """The report as its frame has it; axe cannot look into the sandbox."""
    page = at.page(path="viewer/viewer.css", wanted="body")
    page.set_content(report_page())
    return page


def compared(at: Stand) -> Any:
    page = at.viewer("#depth", "#compare", "#share")
    page.wait_for_selector("#shot:not([hidden])")
    page.wait_for_selector("#told:not(:empty)")
    return page


STATES: dict[str, Callable[[Stand], Any]] = {
    "empty": lambda at: at.page(answers={r"/v1/(jobs|captures)\?": lambda _: NOTHING, r"/v1/rigs$": lambda _: NOTHING}),
    "rigs idle, a capture, a job": lambda at: at.page(),
    "nothing found": lambda at: at.searched("no such name"),
    "everything unfolded": lambda at: at.page(
        f"#more-{at.capture} summary", *(f"#{name}-{at.job} summary" for name in ("results", "log", "manage"))
    ),
    "recording": recording,
    "captures with faults": faulty,
    "jobs in every status": lambda at: at.page(answers={r"/v1/jobs\?": in_every_status}),
    "reconstruct form": lambda at: at.form("Reconstruct…", f"#capture-{at.capture}"),
    "calibrate form": lambda at: at.form("Calibrate…", f"#capture-{at.capture}"),
    "images form": lambda at: at.form("Images…", f"#capture-{at.capture}"),
    "check rig form": lambda at: at.form("Check rig…", f"#capture-{at.capture}"),
    "export form": lambda at: at.form("Export…", f"#job-{at.job}"),
    "evaluate form": lambda at: at.form("Evaluate…", f"#job-{at.job}"),
    "deletion of a capture": lambda at: at.form("Delete", f"#capture-{at.capture}"),
    "deletion of a job": lambda at: at.form("Delete", f"#job-{at.job}"),
    "name and note": lambda at: at.form("Name and note…", f"#capture-{at.capture}"),
    "again with other options": lambda at: at.form("Do again with other options…", f"#job-{at.job}"),
    "all chosen": lambda at: at.page("#choose-all-captures", "#choose-all-jobs"),
    "jobs for many": lambda at: at.page("#choose-all-captures", "#batch-captures", "#dialog summary"),
    "exports of many": lambda at: at.page("#choose-all-jobs", "#export-jobs"),
    "deletion of many": lambda at: at.page("#choose-all-jobs", "#delete-jobs"),
    "token form": refused,
    "a viewer's token": lambda at: at.page(
        answers={r"/v1/info$": changed(role="viewer")}, wanted="#role:not([hidden])"
    ),
    "service away": away,
    "large capture": lambda at: at.page(f"#capture-{at.capture} a.open-large", "#cell-cam00"),
    "large pictures of a job": lambda at: at.page(f"#job-{at.job} a.open-large", "#large-picture"),
    "page of the report": lambda at: at.page(path=f"report.html?job={at.job}", wanted="#save"),
    "report": report,
    "viewer": lambda at: at.viewer(),
    "viewer, free": lambda at: at.viewer("#reset"),
    "viewer, comparing with depth": compared,
    "viewer without a job": lambda at: at.page(path="viewer.html", wanted="#message[role=alert]"),
}


@pytest.fixture(scope="module")
def drawing_chromium() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as runner:
        browser = runner.chromium.launch(executable_path=CHROMIUM, args=SOFTWARE_GL)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, list[dict]]]:
    """Gathers all findings by state, and writes them down in the end."""
    gathered: dict[str, list[dict]] = {}
    yield gathered
    out = Path(os.environ.get("SPIKE4DGS_AXE") or tmp_path_factory.mktemp("axe") / "axe.json")
    rows = [row for rows in gathered.values() for row in rows]
    counts = {impact: float(sum(row["impact"] == impact for row in rows)) for impact in ("minor", "moderate", *GRAVE)}
    document = BenchDocument("axe")
    document.rows = [{"state": state, "axe": version(), "found": rows} for state, rows in gathered.items()]
    document.summary = {"states": float(len(gathered)), **counts}
    write_json(out, document.to_json())


def version() -> str:
    """Return the version of axe-core that comes along."""
    return re.search(r"axe v([\d.]+)", axe_playwright.Axe().axe_script)[1]  # type: ignore[index]


@pytest.fixture
def stand(service: Service, capture: Capture, done: str, drawing_chromium: Any) -> Iterator[Stand]:
    at = Stand(service, drawing_chromium, capture.id, done)
    yield at
    for context in at.contexts:
        for page in context.pages:
            page.unroute_all(behavior="ignoreErrors")  # an answer that is under way would fail in the next state
        context.close()


@pytest.mark.parametrize("state", STATES)
def test_axe_finds_nothing_serious(state: str, stand: Stand, found: dict[str, list[dict]]) -> None:
    page = STATES[state](stand)
    seen: dict[str, dict] = {}
    for width in WIDTHS:
        for scheme, rules in RULES.items():
            page.set_viewport_size({"width": width, "height": 900})
            page.emulate_media(color_scheme=scheme)
            page.wait_for_timeout(200)
            assert page.evaluate(TOO_WIDE) == [], f"{width} px"
            for one in axe_playwright.Axe().run(page, options=rules).response["violations"]:
                row = seen.setdefault(one["id"], {"state": state, "rule": one["id"], "impact": one["impact"], "at": []})
                targets = [str(node["target"][0]) for node in one["nodes"]]
                row["at"].append(f"{width} px, {scheme}")
                row |= {"help": one["help"], "elements": sorted({*row.get("elements", []), *targets})[:20]}
    found[state] = list(seen.values())
    grave = [row for row in seen.values() if row["impact"] in GRAVE]
    assert grave == [], json.dumps(grave, indent=1)
