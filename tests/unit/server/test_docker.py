"""The images and the compose files say nothing that the Makefile and the command line do not know."""

import json
import re
from pathlib import Path

import click
import pytest
import yaml

from server.cli.main import cli
from server.settings import ServiceSettings

ROOT = Path(__file__).parents[3]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
COMPOSE = sorted((ROOT / "docker").glob("compose.*.yaml"))
STAGES = re.findall(r"^FROM \S+ AS (\w+)", DOCKERFILE, re.MULTILINE)


def parse(arguments: list[str]) -> None:
    """Fails where the program does not take these arguments."""
    command = cli.get_command(click.Context(cli), arguments[0])
    assert command is not None, arguments
    command.make_context(arguments[0], arguments[1:])


def test_images_are_built_by_the_makefile() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"^([\w-]+):", makefile, re.MULTILINE))
    runs = re.findall(r"^RUN make ([\w-]+)((?: \w+=\S*)*)", DOCKERFILE, re.MULTILINE)
    assert len(runs) == 3
    for target, settings in runs:
        assert target in targets
        assert all(f"{name.split('=')[0]} ?=" in makefile for name in settings.split())
    assert not re.search(r"\bpip3? install\b", DOCKERFILE)  # what is installed is said in one place


def test_images_run_commands_that_exist() -> None:
    commands = [json.loads(text) for text in re.findall(r"^CMD (\[.*\])$", DOCKERFILE, re.MULTILINE)]
    assert len(commands) == 3
    for command in commands:
        words = (
            command[2].replace("exec ", "").replace('"$(hostname)"', "host").split() if command[0] == "sh" else command
        )
        assert words[0] == "spike4dgs"
        parse(words[1:])


@pytest.mark.parametrize("path", COMPOSE, ids=lambda path: path.stem)
def test_compose_files_use_images_settings_and_commands_that_exist(path: Path) -> None:
    document = yaml.safe_load(path.read_text())
    assert len(COMPOSE) == 3
    for service in document["services"].values():
        if "build" not in service:
            continue
        assert service["build"]["target"] in STAGES
        for name in service.get("environment", {}):
            assert name.removeprefix("SPIKE4DGS_").lower() in ServiceSettings.model_fields
        if "command" in service:
            parse(service["command"][1:])
        for volume in service["volumes"]:
            assert volume.split(":")[0] in document["volumes"]


def test_the_unit_starts_a_command_that_exists() -> None:
    text = (ROOT / "docker" / "spike4dgs.service").read_text()
    found = re.search(r"^ExecStart=\S+/spike4dgs (.*)$", text, re.MULTILINE)
    assert found is not None
    parse(found[1].split())
    settings = re.findall(r"^Environment='?SPIKE4DGS_(\w+)=", text, re.MULTILINE)
    assert {name.lower() for name in settings} <= set(ServiceSettings.model_fields)
