import json
import os
import time
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from reconstruction.export.catalogue import FORMATS
from reconstruction.run.configuration import CHOICES
from rigs.errors import RigError
from rigs.toml import catalog_rig, dump_rig
from server.cli.main import cli
from server.cli.serve import PortError, listening
from server.errors import TargetError
from server.schemas.captures import CaptureRequest
from server.schemas.job_types import JOB_TYPES, ExportRequest, ReconstructRequest
from server.services.targets import allowed_address, target_of
from server.settings import STAGE_COMMAND, RigSource, ServiceSettings, SettingsError, settings_of
from server.store.files import DataFolder
from server.work.commands import reconstruct_arguments, record_arguments, task_arguments


def test_arguments_of_the_stages() -> None:
    request = CaptureRequest(ticks=5).model_dump(exclude={"name"})
    assert record_arguments(request, "lab3x3", "usb:", Path("rec")) == [
        *("record", "--rig", "lab3x3", "--devices", "usb:", "--ticks", "5", "--out", "rec")
    ]
    request = CaptureRequest(until_stopped=True, pre_trigger_ms=5, rejoin_s=0, threshold=900).model_dump()
    assert record_arguments(request, "lab3x3", "usb:", Path("rec"))[5:-2] == [
        *("--pre-trigger", "5.0", "--threshold", "900", "--rejoin", "0.0", "--until-stopped")
    ]
    asked = record_arguments({"ticks": 5}, "lab3x3", "usb:", Path("rec"), keep_free_bytes=20_000_000_001)
    assert asked[5:-2] == ["--ticks", "5", "--keep-free", "20001"]


def test_arguments_of_a_reconstruction() -> None:
    fields = {"holdout": "cam11", "steps": 7, "seed": 0, "views": ["cam00", "cam02"], "span": 64, "from_tick": -3}
    asked = ReconstructRequest.model_validate({"capture": "c", "model": "linear", "to_tick": 800} | fields)
    request = asked.model_dump(exclude={"name", "priority"})
    restart = {"stage": "train", "attempt": 2}
    found = reconstruct_arguments(request, "train", Path("rec"), Path("run"), restart)
    assert found == [
        *("reconstruct", "rec", "--out", "run", "--stage", "train", "--again", "2"),
        *("--model", "linear", "--images", "auto", "--init", "auto", "--points", "auto"),
        *("--supervision", "auto", "--refine", "auto"),
        *("--pixels", "auto", "--gains", "auto", "--device", "auto"),
        *("--holdout", "cam11", "--span", "64", "--from-tick", "-3", "--to-tick", "800", "--steps", "7"),
        *("--seed", "0", "--views", "cam00,cam02"),
    ]
    assert "--again" not in reconstruct_arguments(request, "report", Path("rec"), Path("run"), restart)


@pytest.mark.parametrize(
    ("request_", "arguments"),
    [
        ({"type": "images", "method": "tfi", "ticks": None}, "images rec --method tfi --out out"),
        ({"type": "calibrate", "board": None}, "calibrate rec --natural --out out/rig.toml --json"),
        ({"type": "verify"}, "verify rec --json"),
        ({"type": "evaluate"}, "evaluate run --json"),
        (
            {"type": "export", "format": "spz", "at_s": 0.25, "frames": None, "camera": None},
            "export run --format spz --at 0.25 --out out/scene.spz",
        ),
    ],
    ids=lambda value: value["type"] if isinstance(value, dict) else "",
)
def test_arguments_of_the_tasks(request_: dict[str, object], arguments: str) -> None:
    assert task_arguments(request_, Path("rec"), Path("run"), Path("out")) == arguments.split()


@pytest.mark.parametrize(
    "fields",
    [
        {"type": "images", "capture": "c", "method": "tfi", "ticks": "1:20:3"},
        {"type": "calibrate", "capture": "c"},
        {"type": "calibrate", "capture": "c", "board": "charuco:6x4:100:67.5:DICT_4X4_50"},
        {"type": "check-rig", "capture": "c"},
        {"type": "verify", "capture": "c"},
        {"type": "evaluate", "job": "j"},
        {"type": "render", "job": "j", "cameras": "u"},
        {"type": "export", "job": "j", "format": "spz", "at_s": 0.01},
        {"type": "export", "job": "j", "format": "depth", "from_tick": 5, "to_tick": 9, "camera": "cam00"},
    ],
    ids=str,
)
def test_every_task_is_a_command_line_of_the_program(fields: dict[str, str]) -> None:
    request = JOB_TYPES[fields["type"]].model_validate(fields).model_dump()
    command, *arguments = task_arguments(request, Path("rec"), Path("run"), Path("out"))
    known = cli.get_command(click.Context(cli), command)
    assert known is not None
    flags = {flag for parameter in known.params for flag in parameter.opts}
    assert {argument for argument in arguments if argument.startswith("--")} <= flags


@pytest.mark.parametrize(
    "change",
    [
        *({"budget_s": 5, "steps": 5}, {"model": "crystal"}, {"holdout": "../x"}, {"seed": -1}, {"path": "/etc"}),
        *({"span": 63}, {"from_tick": 1.5}, {"from_tick": 9, "to_tick": 9}, {"from_tick": 9, "to_tick": 8}),
    ],
)
def test_a_request_that_does_not_fit_is_refused(change: dict[str, object]) -> None:
    ReconstructRequest.model_validate({"capture": "c"})
    with pytest.raises(ValidationError):
        ReconstructRequest.model_validate({"capture": "c"} | change)


def test_a_camera_is_named_as_recordings_may_name_it() -> None:
    asked = {"capture": "c", "holdout": "left", "views": ["Right_2", "top-3"]}
    assert ReconstructRequest.model_validate(asked).holdout == "left"
    assert ExportRequest(type="export", job="j", format="ply", camera="left").camera == "left"
    for name in ("--out", "a b", "", "x" * 41):
        with pytest.raises(ValidationError):
            ReconstructRequest.model_validate(asked | {"holdout": name})


def test_settings_come_from_flags_then_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPIKE4DGS_DATA", str(tmp_path / "a"))
    monkeypatch.setenv("SPIKE4DGS_RIGS", json.dumps({"left": {"rig": "ci3x3", "devices": "usb:1"}}))
    settings = settings_of(rig=None, devices=None, port=1234)
    assert (settings.data, settings.port, settings.rigs["left"].devices) == (tmp_path / "a", 1234, "usb:1")
    assert settings_of(rig=None, devices=None, data=tmp_path).data == tmp_path
    assert settings_of(rig="ci3x3", devices=None).rigs == {"ci3x3": RigSource(rig="ci3x3", devices="usb:")}
    with pytest.raises(RigError, match="lab3x3"):
        settings_of(rig="lab9x9", devices=None)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("RIGS", "{lab", "rigs: found {lab, expected JSON; mend the flag or SPIKE4DGS_RIGS"),
        ("RIGS", '{"a": {"rig": "ci3x3"}}', "rigs.a.devices: Field required; mend the flag or SPIKE4DGS_RIGS"),
        ("STAGE_COMMAND", "python", "stage_command: found python, expected JSON"),
        ("PORT", "many", "port: Input should be a valid integer"),
        ("PORT", "70000", "port: Input should be less than or equal to 65535; mend the flag or SPIKE4DGS_PORT"),
        ("DATA", "", "data: found no name, expected that of a folder; mend the flag or SPIKE4DGS_DATA"),
        ("WEBHOOK_HOSTS", "a b", "webhook_hosts.0: found a b, expected the name of a host"),
        ("HOSTS", "lab:x", "hosts.0: found lab:x, expected the name of a host"),
    ],
)
def test_a_variable_that_cannot_be_read_is_one_line(
    name: str, text: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(f"SPIKE4DGS_{name}", text)
    with pytest.raises(SettingsError) as caught:
        settings_of(rig=None, devices=None)
    assert str(caught.value).startswith(said)
    assert "\n" not in str(caught.value)


def test_what_would_be_json_and_is_empty_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compose hands on a variable of the host that is set to nothing."""
    for name in ("RIGS", "STAGE_COMMAND"):
        monkeypatch.setenv(f"SPIKE4DGS_{name}", "")
    settings = settings_of(rig=None, devices=None)
    assert (list(settings.rigs), settings.own_rigs, settings.stage_command) == (["lab3x3"], {}, STAGE_COMMAND)


@pytest.mark.parametrize("name", ["hosts", "webhook_hosts"])
def test_lists_of_hosts_are_written_alike(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(f"SPIKE4DGS_{name.upper()}", "Lab.example, 10.0.0.7")
    assert getattr(settings_of(rig=None, devices=None), name) == ("lab.example", "10.0.0.7")


@pytest.mark.parametrize("host", ["example.org", "1.2.3", "", "127.0.0.1:8000"])
def test_only_an_address_is_bound(host: str) -> None:
    with pytest.raises(SettingsError, match=f"host: found {host}, expected an address") as caught:
        settings_of(rig=None, devices=None, host=host)
    assert caught.value.exit_code == 2
    assert "\n" not in str(caught.value)


def test_a_port_in_use_is_one_line_and_exit_2(tmp_path: Path) -> None:
    with listening("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(PortError, match=f"found port {port} on 127.0.0.1: address already in use; stop what"):
            CliRunner().invoke(
                cli, ["serve", "--data", str(tmp_path / "data"), "--port", str(port)], catch_exceptions=False
            )
    assert PortError.exit_code == 2
    assert not (tmp_path / "data").exists()
    with listening("127.0.0.1", port):
        pass


def test_localhost_is_an_address() -> None:
    assert ServiceSettings(host="localhost").host == "127.0.0.1"


def test_a_job_may_choose_all_that_a_reconstruction_knows_but_what_needs_files_of_the_user() -> None:
    asked = ReconstructRequest.model_json_schema()["properties"]
    refused = {
        "init": {"dust3r"},
        "points": {"random"},
        "images": {"clean", "blurred", "ordinary"},
    }
    for name, names in CHOICES.items():
        assert set(asked[name]["enum"]) == set(names) - refused.get(name, set())
    served = ExportRequest.model_json_schema()["properties"]["format"]["enum"]
    assert set(served) == set(FORMATS) - {"viewer"}


@pytest.mark.parametrize("name", ["lab/one", "..", "", ".hidden", "x" * 65, " lab", "lab\n"])
def test_a_rig_whose_name_is_no_part_of_an_address_is_refused(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SPIKE4DGS_RIGS", json.dumps({name: {"rig": "ci3x3", "devices": "usb:"}}))
    with pytest.raises(SettingsError, match="found the rig's name") as caught:
        settings_of(rig=None, devices=None)
    assert caught.value.exit_code == 2
    monkeypatch.delenv("SPIKE4DGS_RIGS")
    if name:
        (tmp_path / "own.toml").write_text(dump_rig(replace(catalog_rig("ci3x3"), name=name)))
        with pytest.raises(SettingsError, match="found the rig's name"):
            settings_of(rig=str(tmp_path / "own.toml"), devices=None)


@pytest.mark.parametrize(
    ("entry", "url", "named"),
    [
        ("hook.local:9000", "http://hook.local:9000/x", True),
        ("hook.local:9000", "http://hook.local/x", False),
        ("Hook.Local", "http://hook.local:9000/x", True),
        ("[::1]", "http://[::1]:9000/x", True),
        ("[::1]:9000", "http://[::1]:9000/x", True),
        ("[::1]:9000", "http://[::2]:9000/x", False),
    ],
)
def test_a_host_that_the_settings_name_is_let_through(entry: str, url: str, named: bool) -> None:
    with nullcontext() if named else pytest.raises(TargetError, match="private address"):
        assert allowed_address(target_of(url), ["10.0.0.7"], [entry]) == "10.0.0.7"


def test_what_a_killed_removal_left_is_swept(tmp_path: Path) -> None:
    folder = DataFolder(tmp_path)
    for name, age_s in (("old", 7200.0), ("new", 0.0)):
        left = tmp_path / f".removed-{name}" / "c1"
        left.mkdir(parents=True)
        (left / "cam00.dat").write_bytes(b"planes")
        os.utime(left.parent, (time.time() - age_s,) * 2)
    folder.sweep()
    assert sorted(path.name for path in tmp_path.glob(".removed-*")) == [".removed-new"]
