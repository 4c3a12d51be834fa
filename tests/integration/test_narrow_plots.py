"""Plots and reports on a telephone: text that can be read, nothing cut off, nothing to scroll sideways."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from integration.fake_report import report_page
from maintenance.operator_page import BROWSER, Service

pytestmark = BROWSER
LEAST_PX = 11.5
# Of every text of the curve: the size of its letters on the screen, and how far it reaches beyond the drawing, in px.
TEXTS = """(selector) => {
  const svg = document.querySelector(selector), whole = svg.getBoundingClientRect();
  const scale = whole.width / svg.viewBox.baseVal.width;
  return [...svg.querySelectorAll('text')].map((text) => {
    const box = text.getBoundingClientRect();
    const beyond = Math.max(whole.left - box.left, box.right - whole.right, whole.top - box.top,
      box.bottom - whole.bottom);
    return { text: text.textContent, px: scale * parseFloat(getComputedStyle(text).fontSize), beyond, left: box.left,
      right: box.right, top: box.top, bottom: box.bottom };
  });
}"""
COURSES = {
    "short": [(float(s), 33 - 14 * 2 ** (-s / 6)) for s in (2, 4, 8, 16, 32)],
    "of hours": [(3600.0 * h, 20 + h / 7) for h in (1, 5, 11, 23, 30)],
    "of small errors": [(30.0 * n, 0.00123 / n) for n in range(1, 12)],
    "of one minute after a day": [(86_400.0 + n, -101.25 + n) for n in range(1, 60)],
}


@pytest.mark.parametrize("width", [400, 1280])
@pytest.mark.parametrize("course", COURSES)
def test_the_curve_of_a_job_can_be_read(
    course: str, width: int, service: Service, done: str, open_page: Callable[..., Any]
) -> None:
    rows = [{"seconds": s, "psnr_db": value} for s, value in COURSES[course]]
    answer = json.dumps({"held_out": "cam11", "rows": rows})

    def prepare(page: Any) -> None:
        page.route("**/error_vs_time.json", lambda route: route.fulfill(content_type="application/json", body=answer))

    page = open_page(width, prepare=prepare)
    selector = f"#job-{done} .curve svg"
    page.wait_for_selector(selector)
    texts = page.evaluate(TEXTS, selector)
    assert len(texts) >= 5
    for one in texts:
        assert one["px"] >= LEAST_PX, one
        assert one["beyond"] <= 0.5, one
    for a in texts:  # no two labels lie on each other
        for b in texts:
            across = min(a["right"], b["right"]) - max(a["left"], b["left"])
            down = min(a["bottom"], b["bottom"]) - max(a["top"], b["top"])
            assert a is b or min(across, down) <= 1, (a, b)
    assert page.evaluate("document.documentElement.scrollWidth") == width


@pytest.mark.parametrize("width", [400, 1280])
def test_a_report_fits_a_telephone(width: int, chromium: Any, tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    file.write_text(report_page())
    page = chromium.new_page(viewport={"width": width, "height": 800})
    page.goto(file.as_uri())
    page.wait_for_function("document.querySelector('.curve').naturalWidth > 100")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    narrow = page.evaluate(
        "(i => i.currentSrc === i.parentElement.querySelector('source').srcset)(document.querySelector('.curve'))"
    )
    assert narrow == (width == 400)
    box = page.locator(".curve").bounding_box()
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= width
    assert box["width"] > 0.85 * min(width, 800)
    sideways = page.evaluate(
        "[...document.querySelectorAll('*')].filter((e) => e.scrollWidth > e.clientWidth + 1 && e.clientWidth"
        " && getComputedStyle(e).overflowX !== 'visible').map((e) => e.outerHTML.slice(0, 80))"
    )
    assert sideways == []
    smallest = page.evaluate(
        "Math.min(...[...document.querySelectorAll('p, h1, h2, th, td, figcaption, code')]"
        ".filter((e) => e.textContent.trim()).map((e) => parseFloat(getComputedStyle(e).fontSize)))"
    )
    assert smallest >= LEAST_PX
    page.screenshot(path=tmp_path / "report.png", full_page=True)
    page.close()
