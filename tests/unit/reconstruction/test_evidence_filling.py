"""Figures in a text follow the documents they come from."""

import pytest
from maintenance.evidence import filled, hours
from maintenance.evidence_tables import page

from reconstruction.errors import BadRunError

TEXT = (
    "{{one a.db .2f}} dB of {{one count .0f}}, {{two a.db .3f}} less, {{one a.db minus one-off +.1f}}, {{two revision}}"
)
DEVICE = {"processor": "a chip", "threads": 2}
ONE = {"summary": {"a.db": 2.345, "one-off": 12, "count": 7}, "rows": [{"seconds": 1800}, {"seconds": None}, {}]}
TWO = {"summary": {"a.db": -0.5}, "rows": [{"seconds": 3600}], "revision": "abc"}
DOCUMENTS = {"one": ONE | {"revision": "def"}, "two": TWO}


def test_a_figure_is_taken_from_the_document_it_names():
    assert filled(TEXT, DOCUMENTS) in {f"{level} dB of 7, -0.500 less, -9.7, abc" for level in ("2.35", "2.34")}


@pytest.mark.parametrize("text", ["{{one b.db .2f}}", "{{three a.db .2f}}", "{{one a.db minus b.db .2f}}"])
def test_a_figure_nobody_measured_is_refused(text):
    with pytest.raises(BadRunError, match=r"found the figure [ab]\.db, expected one of (one|three)\.json"):
        filled(text, DOCUMENTS)


def test_hours_are_those_of_all_rows():
    assert hours({"one": ONE, "two": TWO}) == pytest.approx(1.5)


def test_a_page_tells_its_revision_and_has_a_table_of_what_several_rows_share():
    summary = {"tfi.psnr_db": 20.0, "spk2imgnet.psnr_db": 30.0, "msdi.psnr_db": 25.0, "speed": 2.0}
    document = {"summary": summary, "rows": [], "omissions": ["x: no weights"], "revision": "abc", "device": DEVICE}
    text = page("images", document)
    assert "revision abc, a chip, 2 threads" in text
    assert "|  | psnr_db |\n| --- | --- |\n| tfi | 20 |\n| small spk2imgnet | 30 |\n| small msdi | 25 |" in text
    assert "| speed | 2 |" in text
    assert text.endswith("- x: no weights\n")
    many = {f"tfi.psnr_db@light{i}": float(i) for i in range(8)}
    assert "| tfi, psnr_db | 0 | 1 | 2 |" in page("images", document | {"summary": many})
