"""Documents are short, their links lead somewhere, and decisions keep their numbers."""

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from acquisition.devices.profile import profiles
from reconstruction.run.configuration import CHOICES

ROOT = Path(__file__).resolve().parents[2]
DOCUMENTS = sorted(p for p in ROOT.rglob("*.md") if not {".venv", "node_modules", "runs"} & set(p.parts))
RECORDS = [p for p in DOCUMENTS if p.name == "DECISIONS.md"]
FIELDS = ("Status", "Context", "Decision", "Consequence")


def name_of(path):
    return str(path.relative_to(ROOT))


def records(path):
    """Return the records of a file as (number, text)."""
    parts = re.split(r"^## (\d+)\. ", path.read_text(), flags=re.MULTILINE)
    return [(int(number), text) for number, text in zip(parts[1::2], parts[2::2], strict=True)]


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_links_lead_somewhere(path):
    links = re.findall(r"\]\(([^)#\s]+)[^)]*\)", path.read_text())
    missing = [link for link in links if "://" not in link and not (path.parent / link).exists()]
    assert missing == []


@pytest.mark.parametrize("path", RECORDS, ids=name_of)
def test_a_record_says_status_context_decision_and_consequence(path):
    for number, text in records(path):
        found = re.findall(r"^- (\w+): ", text, flags=re.MULTILINE)
        assert found == list(FIELDS), f"record {number}"


def test_numbers_are_used_once_and_without_gaps():
    numbers = sorted(number for path in RECORDS for number, _ in records(path))
    assert numbers == list(range(1, len(numbers) + 1))


def test_the_index_lists_every_record_in_its_file():
    rows = re.findall(r"^\| \[[^]]+\]\(([^)]+)\) \| ([\d ]+) \|$", (ROOT / "ARCHITECTURE.md").read_text(), re.MULTILINE)
    listed = {file: [int(number) for number in numbers.split()] for file, numbers in rows}
    assert listed == {name_of(path): sorted(number for number, _ in records(path)) for path in RECORDS}


def test_the_changelog_has_each_release_once_and_begins_with_this_one():
    releases = re.findall(r"^## ([\d.]+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert len(set(releases)) == len(releases)
    assert releases[0] == tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]


def test_code_refers_to_decisions_that_exist():
    numbers = {number for path in RECORDS for number, _ in records(path)}
    found = subprocess.run(["git", "grep", "-hoE", "decision [0-9]+"], cwd=ROOT, capture_output=True, text=True)
    if found.returncode > 1:
        pytest.skip("not a git checkout, so its files cannot be searched")
    assert {int(line.split()[1]) for line in found.stdout.splitlines()} <= numbers


@pytest.mark.parametrize(("name", "lines"), [("ARCHITECTURE.md", 110), ("README.md", 140)])
def test_a_document_stays_short(name, lines):
    assert len((ROOT / name).read_text().splitlines()) <= lines


def test_the_glossary_has_at_most_thirty_terms():
    glossary = (ROOT / "CONVENTIONS.md").read_text().split("## Glossary")[1].split("## ")[0]
    assert 20 <= len(re.findall(r"^\| [^|]+ \| [^|]+ \|$", glossary, re.MULTILINE)) - 1 <= 30


def test_the_readme_says_what_nobody_tried():
    text = (ROOT / "README.md").read_text()
    assert "No real camera was ever connected" in text
    assert "Nothing ever ran on a GPU" in text
    assert ".venv/bin/activate" in text


def test_the_readme_of_reconstruction_names_every_choice():
    text = (ROOT / "reconstruction/README.md").read_text()
    names = {name for names in CHOICES.values() for name in names} - {"auto", "on", "off"}
    assert sorted(name for name in names if f"`{name}`" not in text) == []


def test_the_protocol_names_every_profile():
    text = (ROOT / "acquisition/devices/PROTOCOL.md").read_text()
    assert [name for name in profiles() if f"`{name}`" not in text] == []
