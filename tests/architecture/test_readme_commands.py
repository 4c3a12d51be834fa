"""Every command and example in the documents works as it stands there, on smaller recordings.

Commands in fenced blocks run in order in one folder for each document. SMALLER says what is changed, PARSED says which
commands are only parsed and why. The `curl` lines and Python blocks talk to a service in this process.
"""

import importlib
import json
import re
import shlex
import shutil
import signal
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient

from acquisition.devices.open import Simulation
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from rigs.exchange.nerfstudio import Frame, dump_frames, dump_transforms
from rigs.toml import catalog_rig, dump_rig
from server.app import create_app
from server.cli.main import COMMANDS, cli
from server.client import ServiceClient
from server.contact_sheet import figures
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import ReconstructRequest
from server.settings import ServiceSettings
from server.store.looks import keep_look

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("README.md", "server/README.md", "server/guide/README.md", "acquisition/README.md", "reconstruction/README.md")
# What is changed in a command before it runs: options that get another value or are added; None takes one away.
SMALLER: dict[str, dict[str, str | None]] = {
    "simulate": {"--size": "64x40", "--ticks": "60"},
    "record": {"--ticks": "20", "--devices": "mock:fan_and_ball?samples=1"},
    "preflight": {"--devices": "mock:fan_and_ball?samples=1", "--disk-seconds": "0.1"},
    "import": {"--size": "64x40"},
    "images": {"--size": "64x40", "--ticks": "10:50:20"},
    "reconstruct": {"--budget-s": None, "--steps": "4"},
}
# Commands that are only parsed, by the parser that they have, and why.
PARSED = {
    "calibrate": "minutes, and pictures larger than 64x40",
    "check-rig": "minutes, and pictures larger than 64x40",
    "demo": "a minute of training; `make demo` runs it",
    "serve": "runs until it is stopped; tests/integration/test_service.py starts it",
    "view": "runs until it is stopped; tests/unit/server/test_run_viewer.py starts it",
    "worker": "runs until it is stopped; tests/integration/test_service.py starts it",
    "--weights": "weights of a training of one's own",
}
EXITS = {"preflight": (0, 1)}  # 1: this machine is not ready to record
MAKES = ("record", "import")  # other ways to a recording that is there already: theirs lies beside it


def blocks(name: str, language: str = "") -> list[str]:
    found = re.findall(r"^```(\w*)\n(.*?)^```$", (ROOT / name).read_text(), re.MULTILINE | re.DOTALL)
    return [block for of, block in found if of == language]


def commands(name: str) -> Iterator[list[str]]:
    """Yield the words of every command in the fenced blocks, in order."""
    for block in blocks(name):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words and words[0] in ("spike4dgs", "make", "python", "torchrun"):
                yield words


def resized(words: list[str]) -> list[str]:
    """Return a command with the options of SMALLER."""
    made = list(words)
    for option, value in SMALLER.get(words[1], {}).items():
        if option in made:
            at = made.index(option)
            made[at : at + 2] = []
        made += [option, value] if value is not None else []
    return made


def parse(group: click.Command, words: list[str]) -> None:
    """Parse a command line by its own parser, down to the last subcommand; raises click.UsageError."""
    context = group.make_context("command", list(words), resilient_parsing=False)
    if isinstance(group, click.Group):
        _, command, rest = group.resolve_command(context, [*context._protected_args, *context.args])
        assert command is not None
        parse(command, rest)


def reason_to_parse(words: list[str]) -> str:
    return next((why for word, why in PARSED.items() if word in words), "")


def parse_foreign(words: list[str]) -> None:
    """Parse a line that begins with another program than spike4dgs."""
    if words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(), re.MULTILINE), f"no target {words[1]}"
        return
    at = words.index("-m")
    parse(importlib.import_module(words[at + 1]).main, words[at + 2 :])


@pytest.mark.parametrize("name", NAMES)
def test_every_command_is_one_that_its_parser_knows(name):
    for words in commands(name):
        try:
            parse(cli, words[1:]) if words[0] == "spike4dgs" else parse_foreign(words)
        except click.UsageError as error:
            raise AssertionError(f"{shlex.join(words)}: {error.format_message()}") from error


@pytest.mark.parametrize("name", NAMES)
def test_a_command_in_the_running_text_has_options_that_there_are(name):
    for text in re.findall(r"`spike4dgs ([^`]+)`", (ROOT / name).read_text().replace("\n", " ")):
        command, *words = shlex.split(text)
        if command == "COMMAND":
            continue
        assert command in COMMANDS, text
        found = cli.get_command(click.Context(cli), command)
        if isinstance(found, click.Group):
            found = found.get_command(click.Context(found), words[0])
        assert found is not None, text
        known = {option for parameter in found.params for option in parameter.opts} | {"--help"}
        assert {word for word in words if word.startswith("--")} <= known, text


@pytest.fixture
def restored_signals():
    """Commands set handlers of their own; those of the test runner come back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def prepare(folder: Path) -> None:
    """Lay down the files that a reader of the documents brings, made of the first recording."""
    recording = Recording.open(folder / "rec")
    for camera_id in recording.camera_ids:
        (folder / f"{camera_id}.dat").write_bytes((folder / "rec" / f"{camera_id}.dat").read_bytes())
    (folder / "transforms.json").write_text(dump_transforms(recording.rig.cameras))
    frame = Frame(recording.rig.cameras[4], 0.001)
    (folder / "path.json").write_text(dump_frames([frame], ["view.png"]))


@pytest.mark.slow
@pytest.mark.usefixtures("restored_signals")
@pytest.mark.parametrize("name", [n for n in NAMES if any(w[:2] == ["spike4dgs", "simulate"] for w in commands(n))])
def test_the_commands_run_in_their_order(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ran = []
    for words in commands(name):
        if words[0] != "spike4dgs" or reason_to_parse(words):
            continue
        words = resized(words)
        if words[1] in MAKES and Path(words[words.index("--out") + 1]).exists():
            words[words.index("--out") + 1] += f"-by-{words[1]}"
        result = CliRunner().invoke(cli, words[1:], obj=time.monotonic())
        assert result.exit_code in EXITS.get(words[1], (0,)), f"{shlex.join(words)}: {result.output}{result.exception}"
        ran.append(words[1])
        if words[1] == "simulate":
            prepare(tmp_path)
    assert {"simulate", "verify", "reconstruct", "evaluate", "render", "export", "images"} <= set(ran)


@pytest.fixture
def service(tmp_path, monkeypatch):
    """A service without a worker; clients and `curl` reach it in this process."""
    app = create_app(ServiceSettings(data=tmp_path))
    with TestClient(app, base_url="http://127.0.0.1:8000") as http:
        monkeypatch.setattr(ServiceClient, "at", classmethod(lambda cls, address, token=None: cls(http)))
        monkeypatch.setattr(http, "close", lambda: None)
        yield http


def finish(http: TestClient) -> None:
    """Let all that is queued be done, and every capture have cameras, as if a worker had been there."""
    services = http.app.state.services
    with sqlite3.connect(services.settings.data / "dbos.sqlite") as connection:
        connection.execute("UPDATE workflow_status SET status='SUCCESS'")
    for capture in ServiceClient(http).captures():
        recording = services.store.folder.recording(capture.id)
        recording.mkdir(exist_ok=True)
        (recording / "rig.toml").write_text(dump_rig(catalog_rig("lab3x3")))


@pytest.mark.parametrize(("name", "code"), [(name, block) for name in NAMES for block in blocks(name, "python")])
def test_a_python_example_runs(name, code, service, monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda _: finish(service))  # while an example waits, work is done
    exec(compile(code, name, "exec"), {})


def requests() -> list[str]:
    return [line for name in NAMES for line in re.findall(r"`(curl [^`]+)`", (ROOT / name).read_text())]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("small") / "rec"
    simulate(Simulation("fan_and_ball", samples=1), catalog_rig("lab3x3").scaled(24, 16), 201, path)
    return path


@pytest.fixture
def seeded(service, recording) -> dict[str, str]:
    """A rig that was looked at, a capture and a reconstruction of it, both done: CID and JID stand for their ids."""
    client, store = ServiceClient(service), service.app.state.services.store
    capture = client.start_capture("lab3x3", CaptureRequest(ticks=40))
    shutil.copytree(recording, store.folder.recording(capture.id))
    seen = figures(Recording.open(recording))
    keep_look(store.folder.rig("lab3x3"), seen, {camera.id: b"a PNG" for camera in seen})
    finish(service)
    job = client.submit(ReconstructRequest(capture=capture.id, holdout="cam11"))
    finish(service)
    run = store.folder.run(job.id)
    run.mkdir(parents=True)
    made = {"report.html": "<title>report</title>", "viewer.json": '{"white": 1.0}'}
    for name, text in made.items():
        (run / name).write_text(text)
    (run / "preview.png").write_bytes(b"\x89PNG")
    store.artefacts.catalogue(job.id, run, iter(made))
    return {"CID": capture.id, "JID": job.id}


@pytest.mark.parametrize("line", requests())
def test_a_request_by_curl_is_answered(line, service, seeded):
    for name, entry_id in seeded.items():
        line = line.replace(name, entry_id)
    words = shlex.split(line)
    address = next(word for word in words if word.startswith("$S")).replace("$S", "/v1")
    method = words[words.index("-X") + 1] if "-X" in words else "GET"
    body = json.loads(words[words.index("-d") + 1]) if "-d" in words else None
    answer = service.request(method, address, json=body)
    assert answer.is_success, f"{line}: {answer.text}"
