"""The viewer beside one run: the page, the two files it plays, its recording's pictures, and nothing else."""

import io
import json
import shutil
import signal
import subprocess
import sys
import urllib.request

import numpy as np
import pytest
from click.testing import CliRunner
from fastapi.testclient import TestClient
from integration.fake_scene import write_scene
from PIL import Image

from acquisition.devices.open import Simulation
from acquisition.recording.reader import Recording
from acquisition.session.record import simulate
from reconstruction.errors import BadRunError
from reconstruction.report.seen import seen
from reconstruction.run.configuration import ReconstructionConfig
from reconstruction.run.folder import RunFolder
from rigs.toml import catalog_rig
from server.cli.main import cli
from server.run_viewer import viewer_app

NAME = "my run, 2nd & last"


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / NAME
    write_scene(folder, "polynomial")
    (folder / "run.json").write_text("{}")
    return folder


@pytest.fixture
def http(run):
    return TestClient(viewer_app(run), base_url="http://127.0.0.1:8000")


def test_the_address_leads_to_the_scene(http):
    found = http.get("/")
    assert found.url.path == "/viewer.html"
    assert dict(found.url.params) == {"job": NAME}
    assert "viewer.js" in found.text
    described = http.get("/v1/jobs/x").json()
    assert (described["name"], described["request"]) == (NAME, {})


def test_both_files_are_served_whole_and_in_parts(http, run):
    assert http.get("/v1/jobs/x/artefacts/viewer.json").json() == json.loads((run / "viewer.json").read_text())
    whole = (run / "viewer.bin").read_bytes()
    found = http.get("/v1/jobs/x/artefacts/viewer.bin", headers={"Range": "bytes=4-11"})
    assert (found.status_code, found.content) == (206, whole[4:12])
    assert found.headers["etag"] == http.get("/v1/jobs/x/artefacts/viewer.bin").headers["etag"]


@pytest.mark.parametrize("path", ["artefacts/run.json", "artefacts/..%2F..%2Fetc%2Fpasswd", "pictures", "log"])
def test_nothing_else_is_served(http, path):
    found = http.get(f"/v1/jobs/x/{path}")
    assert found.status_code == 404
    assert found.headers["content-type"] == "application/problem+json"


def test_what_the_cameras_saw_is_shown_while_the_recording_is_there(tmp_path):
    recording, folder = tmp_path / "rec", tmp_path / "run"
    simulate(Simulation("fan_and_ball", seed=1), catalog_rig("lab3x3").scaled(40, 26), 60, recording)
    RunFolder.start(folder, ReconstructionConfig(), recording, "0123abc")
    write_scene(folder, "polynomial")
    http = TestClient(viewer_app(folder), base_url="http://127.0.0.1:8000")
    known = http.get("/v1/jobs/x/pictures").json()
    facts = (known["capture"], known["planes"], known["tick_rate_hz"], known["white"], known["method"])
    assert facts == ("rec", 60, 20_000, 0.4, "adaptive")
    assert known["cameras"] == list(catalog_rig("lab3x3").ids)
    found = http.get("/v1/jobs/x/pictures/cam11?plane=30")
    assert found.headers["content-type"] == "image/png"
    np.testing.assert_array_equal(
        np.asarray(Image.open(io.BytesIO(found.content))), seen(Recording.open(recording).stream("cam11"), 30, 0.4)
    )
    assert http.get("/v1/jobs/x/pictures/cam11?plane=60").status_code == 422
    assert http.get("/v1/jobs/x/pictures/cam99?plane=0").status_code == 404
    shutil.rmtree(recording)
    gone = http.get("/v1/jobs/x/pictures")
    assert gone.status_code == 404
    assert "expected the recording that it was made of" in gone.json()["detail"]


def test_another_host_name_is_refused(http):
    assert http.get("/", headers={"Host": "elsewhere.example"}).status_code == 403


@pytest.mark.parametrize("lacking", ["viewer.json", "viewer.bin"])
def test_a_run_without_its_scene_is_refused(run, lacking):
    (run / lacking).unlink()
    with pytest.raises(BadRunError, match=rf"found no {lacking}, expected a run with its report"):
        viewer_app(run)
    assert CliRunner().invoke(cli, ["view", str(run)]).exception.exit_code == 2


def test_the_command_prints_its_address_and_ends_quietly(run):
    command = [sys.executable, "-m", "server.cli", "view", str(run)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        address = process.stdout.readline().strip()
        with urllib.request.urlopen(f"{address}/v1/jobs/x") as answer:
            assert json.load(answer)["name"] == NAME
        process.send_signal(signal.SIGINT)
        _, err = process.communicate()
    assert (process.returncode, err) == (0, "")
