"""The operator's guide, step by step in a real browser, before a service that really records and reconstructs.

Each heading of "The day" is a step here of the same name, in the same order. A step uses everything that its section
prints in bold, and takes the pictures that the section shows. `make guide` puts them beside the guide.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from maintenance.operator_page import BROWSER, CHROMIUM, expect
from maintenance.waiting import wait_for
from PIL import Image

from rigs.toml import catalog_rig, dump_rig
from server.client import ServiceClient

pytestmark = BROWSER
GUIDE = Path(__file__).parents[2] / "server" / "guide" / "README.md"
PICTURES = os.environ.get("SPIKE4DGS_GUIDE")  # where the pictures are to lie; nowhere in a test
STEPS_OF_TEST = 20
LONG_MS = 600_000  # real recordings and trainings, on a machine that may be busy
RIG = "#rig-lab3x3"
SIZE, TICKS = ((400, 250), 400) if PICTURES else ((160, 102), 120)
WINDOW = {"width": 1280, "height": 800}
GL = ("--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")


@dataclass
class Day:
    """One operator's browser before the service; notes the words that were used and the pictures that were taken."""

    page: Any
    client: ServiceClient
    folder: Path
    used: set[str] = field(default_factory=set)
    taken: set[str] = field(default_factory=set)

    def press(self, word: str, within: str = "body") -> None:
        """Press the button, link or fold that says `word`."""
        place = self.page.locator(within)
        place.locator("button, a, summary, label", has_text=re.compile(f"^{re.escape(word)}")).first.click()
        self.used.add(word)

    def fill(self, word: str, value: str, within: str = "body") -> None:
        """Type into the field that is called `word`."""
        self.page.locator(within).get_by_label(word, exact=False).first.fill(value)
        self.used.add(word)

    def see(self, text: str, within: str = "body") -> None:
        """Wait until `text` stands on the page."""
        expect(self.page.locator(within).get_by_text(text).first).to_be_visible()
        self.used.add(text)

    def take(self, name: str, within: str | None = None) -> None:
        """Take a picture of the window, or of an element."""
        self.page.evaluate("scrollTo(0, 0)")
        self.page.wait_for_timeout(300)  # pictures in it appear
        (self.page.locator(within).first if within else self.page).screenshot(path=self.folder / name)
        self.taken.add(name)

    def queue(self) -> None:
        """Send the form of a job, and wait until its card is there."""
        before = self.job if self.client.jobs(limit=1) else ""
        self.press("Queue", "#dialog")
        wait_for(lambda: self.client.jobs(limit=1) != [] and self.job != before)
        expect(self.page.locator(self.job)).to_be_visible()

    def record(self, name: str) -> None:
        """Send the form of a capture, and wait until it is recorded."""
        self.fill("Name", name, RIG)
        self.press("Record", f"{RIG} form")
        wait_for(lambda: [one.name for one in self.client.captures(limit=1)] == [name])
        self.ended(self.capture)

    def ended(self, card: str) -> None:
        """Wait until a capture or job is done."""
        expect(self.page.locator(f"{card} .status")).to_have_text("done", timeout=LONG_MS)

    def followed(self, word: str, within: str) -> Any:
        """Return the page behind a link, in a window of its own."""
        address = self.page.locator(within).get_by_role("link", name=word).get_attribute("href")
        self.used.add(word)
        made = self.page.context.new_page()
        made.set_viewport_size(WINDOW if PICTURES else {"width": 640, "height": 400})  # the viewer draws without a GPU
        made.set_default_timeout(60_000)
        made.goto(f"{self.page.url.rstrip('/')}{address}")
        return made

    @property
    def capture(self) -> str:
        return f"#capture-{self.client.captures(limit=1)[0].id}"

    @property
    def job(self) -> str:
        return f"#job-{self.client.jobs(limit=1)[0].id}"


STEPS: dict[str, Callable[[Day], None]] = {}


def step(heading: str) -> Callable[[Callable[[Day], None]], Callable[[Day], None]]:
    def add(act: Callable[[Day], None]) -> Callable[[Day], None]:
        STEPS[heading] = act
        return act

    return add


@step("Is the rig ready?")
def ready(day: Day) -> None:
    day.press("Preflight", RIG)
    day.see("Preflight:", RIG)


@step("What do the cameras see?")
def look(day: Day) -> None:
    day.press("Look", RIG)
    day.page.locator(f"{RIG} .view img").click()
    expect(day.page.locator("#large .cell")).to_have_count(9)
    day.press("Live", "#large")
    expect(day.page.locator("#large")).to_contain_text("of the best")
    day.take("large.png")
    day.press("Live", "#large")
    day.page.keyboard.press("Escape")


@step("Record")
def record(day: Day) -> None:
    day.fill("Ticks", f"{TICKS}", RIG)
    assert float(day.page.get_by_label("Milliseconds").input_value()) == TICKS / 20
    day.used.add("Milliseconds")
    day.record("first")
    day.see("No plane lost", day.capture)


@step("Where do the cameras stand?")
def calibrate(day: Day) -> None:
    day.press("More", day.capture)
    day.press("Calibrate…", day.capture)
    day.queue()
    day.ended(day.job)
    day.press("Calibration", RIG)
    day.press("More", day.capture)


@step("Reconstruct")
def reconstruct(day: Day) -> None:
    day.press("Reconstruct…", day.capture)
    day.fill("Budget", "60", "#dialog")
    if not PICTURES:  # the same on any machine
        day.fill("Budget", "", "#dialog")
        day.press("More options", "#dialog")
        day.fill("Steps", str(STEPS_OF_TEST), "#dialog")
    day.queue()
    expect(day.page.locator(f"{day.job} .curve")).to_be_visible(timeout=LONG_MS)
    day.page.wait_for_timeout(20_000 if PICTURES else 0)  # the curve grows
    day.take("page.png")
    day.ended(day.job)
    day.see("On cam11", day.job)
    day.take("job.png", day.job)


@step("Fly through it")
def fly(day: Day) -> None:
    operator = day.page
    shown = f"{day.job} .actions"
    day.page = day.followed("View in 4D", shown)
    day.page.wait_for_selector("#picture[data-settled=yes]")
    day.press("Play", "#controls")
    day.press("Pause", "#controls")
    day.page.wait_for_selector("#picture[data-settled=yes]")
    day.take("viewer.png")
    day.press("Compare", "#controls")
    expect(day.page.locator("#shot")).to_be_visible()
    day.take("viewer-compare.png")
    day.press("Compare", "#controls")
    day.press("Depth", "#controls")
    day.page.wait_for_selector("#picture[data-settled=yes]")
    day.take("viewer-depth.png")
    with day.page.expect_download() as saved:
        day.press("Save picture", "#controls")
    assert saved.value.suggested_filename.endswith(".png")
    day.press("Link to this view", "#controls")
    assert "#" in day.page.locator("#link").input_value()
    day.page.close()
    day.page = operator
    report = day.followed("Report", shown)
    report.frame_locator("#report").get_by_text("PSNR").first.wait_for()
    report.close()


@step("Take it elsewhere")
def export(day: Day) -> None:
    day.press("Export…", day.job)
    day.queue()
    day.ended(day.job)
    day.see("Export of Reconstruction of first", day.job)
    with day.page.expect_download() as saved:
        day.press("Download", day.job)
    assert Path(saved.value.path()).stat().st_size > 1000


@step("Do several at once")
def several(day: Day) -> None:
    day.record("second")
    day.press("Choose all shown", "#captures-chosen")
    day.press("Queue jobs for", "#captures-chosen")
    day.page.select_option("#batch-type", "verify")
    day.queue()
    expect(day.page.locator("#jobs > li", has_text="Verification")).to_have_count(2)
    day.take("queue.png")
    for job in day.client.jobs(limit=2):
        wait_for(lambda job=job: day.client.job(job.id).status == "done")


@step("Find it again")
def find(day: Day) -> None:
    day.press("More", day.capture)
    day.press("Name and note…", day.capture)
    day.page.fill("#label-note", "the fan ran at half speed")
    day.press("Keep", "#dialog")
    expect(day.page.locator("#dialog")).to_have_count(0)
    day.fill("Search", "half speed")
    expect(day.page.locator("#captures > li")).to_have_count(1)
    expect(day.page.locator("#found")).to_contain_text("Found 1 capture")
    day.fill("Search", "")


@step("Bring recordings of other programs")
def bring(day: Day) -> None:
    first = day.client.captures(limit=2)[1].id
    with day.page.expect_file_chooser() as files:
        day.press("Import…", "#import")
    files.value.set_files(sorted((day.folder / "data" / "captures" / first).glob("*.dat")))
    expect(day.page.locator("#import-state")).to_have_text("9 of 9 files sent")
    expect(day.page.locator(".peek")).to_have_count(9)
    day.take("import.png")
    day.press("Import", "#large")
    expect(day.page.locator("#large")).to_have_count(0)
    wait_for(lambda: len(day.client.captures()) == 3)
    day.ended(day.capture)
    day.used.add("Captures")


@step("Do it from the hall")
def telephone(day: Day) -> None:
    day.page.set_viewport_size({"width": 400, "height": 860})
    day.take("page-400.png")
    assert day.page.evaluate("document.documentElement.scrollWidth") == 400


def sections() -> dict[str, str]:
    """Return the sections of "The day" by their headings."""
    day = GUIDE.read_text().split("\n## The day\n")[1].split("\n## ")[0]
    parts = re.split(r"^### \d+\. (.*)$", day, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.fixture
def day(tmp_path: Path) -> Iterator[Day]:
    from playwright.sync_api import sync_playwright

    rig = tmp_path / "lab3x3.toml"
    rig.write_text(dump_rig(catalog_rig("lab3x3").scaled(*SIZE)))
    command = [sys.executable, "-m", "server.cli", "serve", "--port", "0", "--data", str(tmp_path / "data")]
    command += ["--rig", str(rig), "--devices", "mock:fan_and_ball?rig_error=1", "--with-worker"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process, sync_playwright() as runner:
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        browser = runner.chromium.launch(executable_path=CHROMIUM, args=list(GL))
        page = browser.new_context(viewport=WINDOW).new_page()
        page.set_default_timeout(60_000)
        page.goto(address)
        with ServiceClient.at(address) as client:
            wait_for(lambda: client.checks()["worker"].ok)
            yield Day(page, client, tmp_path)
        browser.close()
        process.terminate()


def test_the_day_of_the_guide_is_carried_out(day: Day) -> None:
    told = sections()
    assert list(told) == list(STEPS)
    for heading, act in STEPS.items():
        day.used.clear()
        day.taken.clear()
        try:
            act(day)
        except Exception:
            day.page.screenshot(path=day.folder / "fault.png")
            raise
        assert set(re.findall(r"\*\*(.+?)\*\*", told[heading])) <= day.used, heading
        assert set(re.findall(r"\((\S+\.png)\)", told[heading])) == day.taken, heading
    if PICTURES:
        for name in re.findall(r"\((\S+\.png)\)", GUIDE.read_text()):
            Image.open(day.folder / name).convert("RGB").quantize(256).save(Path(PICTURES) / name, optimize=True)
