"""Every figure and every table of EVIDENCE.md is what the committed documents say, and every link leads somewhere."""

import json
import re

import pytest
from maintenance.evidence import (
    BENCHMARKS,
    CLAIMS,
    FIGURE,
    INDEX,
    ROOT,
    filled,
    looks_page,
    read_documents,
    write_pages,
)

from acquisition.scenes.looks import LOOKS, looks_of, read_looks
from reconstruction.bench.paper.protocol import PROTOCOL

DOCUMENTS = read_documents()
TEXT, MEASUREMENTS = (ROOT / "EVIDENCE.md").read_text(), (BENCHMARKS / "README.md").read_text()
MOST_WORDS = 1250  # of two pages


@pytest.mark.parametrize(("text", "template"), [(TEXT, CLAIMS), (MEASUREMENTS, INDEX)])
def test_the_texts_say_what_the_documents_say(text, template):
    assert filled(template.read_text(), DOCUMENTS) == text, "edit the template and run `make evidence`"


def test_the_text_is_two_pages_with_ten_claims():
    assert len(re.sub(r"\(\S+\)", "", TEXT).split()) <= MOST_WORDS
    assert TEXT.count("\n| **") == 10


def test_every_document_stands_behind_a_table_of_its_own_that_the_text_links(tmp_path):
    for name in DOCUMENTS:
        (tmp_path / f"{name}.json").write_text((BENCHMARKS / f"{name}.json").read_text())
    write_pages(tmp_path, DOCUMENTS)
    for name, document in DOCUMENTS.items():
        page = (tmp_path / f"{name}.md").read_text()
        assert (BENCHMARKS / f"{name}.md").read_text() == page, "run `make evidence`"
        assert document["revision"] in page
        assert document["device"]["processor"] in page
        assert f"({name}.md)" in MEASUREMENTS


@pytest.mark.parametrize("document", ["EVIDENCE.md", "README.md", "tests/benchmarks/README.md"])
def test_every_link_leads_to_a_file(document):
    links = re.findall(r"\]\(([^)#]+)\)", (ROOT / document).read_text())
    local = [link for link in links if "://" not in link]
    assert local
    assert [link for link in local if not ((ROOT / document).parent / link).exists()] == []


def test_figures_come_from_documents_of_which_each_has_its_revision():
    names = {found[1] for template in (CLAIMS, INDEX) for found in FIGURE.finditer(template.read_text())}
    assert names <= set(DOCUMENTS)
    assert all(DOCUMENTS[name]["revision"] for name in names)


def test_no_row_is_without_a_measurement():
    tables = "".join((BENCHMARKS / f"{name}.md").read_text() for name in DOCUMENTS)
    assert not re.search(r"\| 0 of \d+ \|", tables)


def test_rows_have_their_true_names():
    paper = (BENCHMARKS / "paper.md").read_text() + json.dumps(DOCUMENTS["paper"]["rows"])
    assert "+ SPSS (the paper" not in TEXT + paper
    assert "spss" not in paper
    rows = [line for line in (BENCHMARKS / "paper.md").read_text().splitlines() if line.startswith("| ")]
    ours = [line.split(" | ")[0] for line in rows]
    rows = [row for table in PROTOCOL.tables for row in table.rows if row.method]
    published = {f"| {row.label}" for row in rows if row.method.choices.get("model") == "4dgs"}
    assert not [label for label in ours if re.search(r"(?<!small )4DGS", label) and label not in published]


def test_the_log_of_looks_has_all_that_the_documents_show_and_a_page():
    looks = read_looks(BENCHMARKS / LOOKS)
    known = {(look["bench"], look["revision"], look["scene"]) for look in looks}
    shown = [look for document in DOCUMENTS.values() for look in looks_of(document, "2026-01-01")]
    assert [look for look in shown if (look["bench"], look["revision"], look["scene"]) not in known] == []
    assert (BENCHMARKS / "looks.md").read_text() == looks_page(looks), "run `make evidence`"
    assert "(tests/benchmarks/looks.md)" in TEXT
