import json
from datetime import UTC, datetime
from pathlib import Path

import pytest
from click.testing import CliRunner
from pydantic import ValidationError

from rigs.errors import RigError
from server.catalogue import Catalogue
from server.cli.main import cli
from server.cli.serve import PortError, listening
from server.errors import NotFoundError
from server.jobs import reconstruct_arguments, record_arguments
from server.schemas import CaptureRequest, JobRequest, Progress
from server.settings import RigSource, ServiceSettings, SettingsError, settings_of


def test_arguments_of_the_stages() -> None:
    rig = RigSource(rig="lab3x3", devices="usb:")
    assert record_arguments(CaptureRequest(ticks=5), rig, Path("rec")) == [
        *("record", "--rig", "lab3x3", "--devices", "usb:", "--ticks", "5", "--out", "rec")
    ]
    request = JobRequest(capture="c", model="linear", holdout="cam11", steps=7, seed=0)
    assert reconstruct_arguments(request, "train", Path("rec"), Path("run")) == [
        *("reconstruct", "rec", "--out", "run", "--stage", "train"),
        *("--model", "linear", "--images", "auto", "--init", "auto", "--supervision", "auto"),
        *("--holdout", "cam11", "--steps", "7", "--seed", "0"),
    ]


@pytest.mark.parametrize(
    "change", [{"budget_s": 5, "steps": 5}, {"model": "crystal"}, {"holdout": "../x"}, {"seed": -1}, {"path": "/etc"}]
)
def test_a_request_that_does_not_fit_is_refused(change: dict[str, object]) -> None:
    JobRequest.model_validate({"capture": "c"})
    with pytest.raises(ValidationError):
        JobRequest.model_validate({"capture": "c"} | change)


def test_the_catalogue_keeps_entries_and_progress(tmp_path: Path) -> None:
    times = iter([datetime(2024, 5, 6, 7, 8, 9, tzinfo=UTC), datetime(2024, 5, 6, 7, 8, 10, tzinfo=UTC)])
    catalogue = Catalogue(tmp_path, clock=lambda: next(times), token=lambda: "beef")
    first, second = (catalogue.add("capture", {"rig": "r", "ticks": n}) for n in (1, 2))
    assert first.id == "c20240506-070809-beef"
    assert catalogue.entries("capture") == [second, first]
    assert catalogue.entries("job") == []
    assert catalogue.progress(first.id) == Progress()
    catalogue.write_progress(first.id, Progress(stage="record", seconds={"record": 1.5}))
    assert catalogue.progress(first.id).seconds == {"record": 1.5}
    catalogue.remove(second.id)
    assert catalogue.entries("capture") == [first]
    assert [path.name for path in catalogue.folder(first.id).iterdir() if path.name.startswith(".")] == []


@pytest.mark.parametrize(
    "name", ["", "..", "../../etc", "c20240506-070809-beef/..", "j20240506-070809-beef", "c" * 500]
)
def test_the_catalogue_knows_nothing_else(tmp_path: Path, name: str) -> None:
    catalogue = Catalogue(tmp_path, clock=lambda: datetime(2024, 5, 6, 7, 8, 9, tzinfo=UTC), token=lambda: "beef")
    catalogue.add("capture", {})
    with pytest.raises(NotFoundError):
        catalogue.entry("capture", name)


def test_settings_come_from_flags_then_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPIKE4DGS_DATA", str(tmp_path / "a"))
    monkeypatch.setenv("SPIKE4DGS_RIGS", json.dumps({"left": {"rig": "ci3x3", "devices": "usb:1"}}))
    settings = settings_of(rig=None, devices=None, port=1234)
    assert (settings.data, settings.port, settings.rigs["left"].devices) == (tmp_path / "a", 1234, "usb:1")
    assert settings_of(rig=None, devices=None, data=tmp_path).data == tmp_path
    assert settings_of(rig="ci3x3", devices=None).rigs == {"ci3x3": RigSource(rig="ci3x3", devices="usb:")}
    with pytest.raises(RigError, match="lab3x3"):
        settings_of(rig="lab9x9", devices=None)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "example.org", "::"])
def test_only_loopback_is_bound(host: str) -> None:
    with pytest.raises(SettingsError, match=f"host: found {host}, expected a loopback address") as caught:
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
