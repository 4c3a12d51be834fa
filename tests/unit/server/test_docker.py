"""The images and the compose files say nothing that the Makefile and the command line do not know."""

import json
import re
from pathlib import Path

import click
import pytest
import yaml
from fastapi.testclient import TestClient

from acquisition.devices.profile import VENDOR_ID, profiles
from acquisition.devices.trigger_box import BOX_PRODUCT_ID
from server.app import create_app
from server.cli.main import cli
from server.settings import ServiceSettings

ROOT = Path(__file__).parents[3]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
MADE = "-made"  # the stages where images are made, with compilers; they never run
COMPOSE = sorted((ROOT / "docker").glob("compose.*.yaml"))
STAGES = dict(reversed(found) for found in re.findall(r"^FROM (\S+) AS ([\w-]+)", DOCKERFILE, re.MULTILINE))
IMAGES = [name for name, base in STAGES.items() if base == "base"]


def parse(arguments: list[str]) -> None:
    """Fails where the program does not take these arguments."""
    command = cli.get_command(click.Context(cli), arguments[0])
    assert command is not None, arguments
    command.make_context(arguments[0], arguments[1:])


def test_images_are_built_by_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))
    runs = re.findall(r"^RUN make ([\w-]+)((?: \w+=\S*)*)", DOCKERFILE, re.MULTILINE)
    assert len(runs) == len(IMAGES) + 1  # and the viewer
    for target, settings in runs:
        assert target in targets
        assert all(f"{name.split('=')[0]} ?=" in makefile for name in settings.split())
    assert not re.search(r"\bpip3? install\b", DOCKERFILE)  # what is installed is said in one place


def test_images_run_commands_that_exist() -> None:
    commands = [json.loads(text) for text in re.findall(r"^CMD (\[.*\])$", DOCKERFILE, re.MULTILINE)]
    assert len(commands) == len(IMAGES)
    for command in commands:
        words = (
            command[2].replace("exec ", "").replace('"$(hostname)"', "host").split() if command[0] == "sh" else command
        )
        assert words[0] == "spike4dgs"
        parse(words[1:])


def test_images_hold_what_was_made_and_no_compiler() -> None:
    assert IMAGES == ["server", "capture", "worker", "appliance"]
    for name in IMAGES:
        body = re.search(rf"AS {name}\n(.*?)(?=^FROM|\Z)", DOCKERFILE, re.MULTILINE | re.DOTALL)
        assert body is not None
        assert f"COPY --from={name}{MADE} " in body[1]
        assert "RUN" not in body[1]
    base = re.search(r"AS base\n(.*?)^FROM", DOCKERFILE, re.MULTILINE | re.DOTALL)
    assert base is not None
    assert not re.search(r"g\+\+|python3-dev|npm|make", base[1])
    assert "--mount" not in DOCKERFILE  # which older builders do not know


def test_every_device_has_its_rule() -> None:
    text = (ROOT / "docker" / "70-spike4dgs.rules").read_text()
    ids = r'^SUBSYSTEM=="{}", ATTRS?{{idVendor}}=="(\w{{4}})", ATTRS?{{idProduct}}=="(\w{{4}})", GROUP="plugdev"'
    found = {
        kind: {(int(a, 16), int(b, 16)) for a, b in re.findall(ids.format(kind), text, re.MULTILINE)}
        for kind in ("usb", "hidraw")
    }
    assert found["usb"] == {(one.vendor_id, one.product_id) for one in profiles().values()}
    assert found["hidraw"] == {(VENDOR_ID, BOX_PRODUCT_ID)}


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_compose_files_use_images_settings_and_commands_that_exist(path: Path) -> None:
    document = yaml.safe_load(path.read_text())
    assert len(COMPOSE) == 3
    for service in document["services"].values():
        if "build" not in service:
            continue
        assert service["build"]["target"] in IMAGES
        for name, value in service.get("environment", {}).items():
            assert name == "PGPASSWORD" or name.removeprefix("SPIKE4DGS_").lower() in ServiceSettings.model_fields
            assert name == "PGPASSWORD" or "PASSWORD" not in (value or "")  # a URL does not take every character
        if service.get("network_mode") == "host":
            assert "healthcheck" in service
        if "command" in service:
            parse(service["command"][1:])
        for volume in service["volumes"]:
            source = re.sub(r"\$\{.*?\}", "./rigs", volume).split(":")[0]
            assert source in (*document["volumes"], "/dev", "./rigs")


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_no_default_in_a_compose_file_has_braces(path: Path) -> None:
    """Older releases end a default at its first closing brace, and the rest of it is put behind any value."""
    assert not re.findall(r"\$\{\w+:?[-?][^}]*\{", path.read_text())


def test_what_opens_the_viewer_has_it() -> None:
    for path in COMPOSE:
        for name, service in yaml.safe_load(path.read_text())["services"].items():
            if "build" not in service:
                continue
            target = service["build"]["target"]
            command = re.search(rf"AS {target}\n(?:.*\n)*?CMD (.*)", DOCKERFILE)
            assert command is not None
            serves = "serve" in service.get("command", json.loads(command[1]))
            assert (STAGES[target + MADE] == "viewer") == serves, (path.name, name)
    assert "server/page/viewer/vendor" in (ROOT / ".dockerignore").read_text().split()  # it is made in the image


def test_the_unit_starts_a_command_that_exists() -> None:
    text = (ROOT / "docker" / "spike4dgs.service").read_text()
    found = re.search(r"^ExecStart=\S+/spike4dgs (.*)$", text, re.MULTILINE)
    assert found is not None
    parse(found[1].split())
    settings = re.findall(r"^Environment='?SPIKE4DGS_(\w+)=", text, re.MULTILINE)
    assert {name.lower() for name in settings} <= set(ServiceSettings.model_fields)


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_who_watches_a_container_is_let_in_where_the_service_has_tokens(path: Path, tmp_path: Path) -> None:
    services = yaml.safe_load(path.read_text())["services"].values()
    (checked,) = [one["healthcheck"]["test"][-1] for one in services if one.get("network_mode") == "host"]
    found = re.search(r"urlopen\('http://127.0.0.1:8000(\S+)'\)", checked)
    assert found is not None
    with TestClient(create_app(ServiceSettings(data=tmp_path)), base_url="http://127.0.0.1") as http:
        store = http.app.state.services.store  # type: ignore[attr-defined]
        store.tokens.add("me", "operator")
        http.app.state.services.access._read_at = None  # type: ignore[attr-defined]
        assert http.get(found[1]).status_code == 503  # no worker
        store.workers.enter("a", ["tasks"])
        assert http.get(found[1]).status_code == 200


def test_what_stops_is_given_as_long_everywhere() -> None:
    """A worker's stage has 20 s to stop, and its worker five more."""
    for path in COMPOSE:
        for service in yaml.safe_load(path.read_text())["services"].values():
            assert "build" not in service or service["stop_grace_period"] == "30s"
    assert "TimeoutStopSec=30\n" in (ROOT / "docker" / "spike4dgs.service").read_text()
