"""The training bench on one small recording: its document, its sheet, and that it resumes."""

import numpy as np
import pytest

from acquisition.devices.open import Simulation
from acquisition.progress import silent
from acquisition.session.record import simulate
from reconstruction.bench import training as bench
from reconstruction.bench.contact_sheet import write_run_strip, write_sheet
from reconstruction.bench.plot import plot_training
from reconstruction.bench.training import Clip, bench_training
from reconstruction.bench.variants import AUTO, CLEAN, VARIANTS, Variant
from rigs.toml import catalog_rig

pytestmark = [pytest.mark.slow, pytest.mark.long]
SCENE = "fan_and_ball"


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    path = tmp_path_factory.mktemp("recordings") / "rec"
    simulate(Simulation(SCENE, seed=3), catalog_rig("ci3x3"), 120, path)
    return [Clip(SCENE, 3, path)]


def test_a_bench_scores_what_it_ran_and_runs_nothing_twice(clips, tmp_path, monkeypatch):
    small = {"gaussians": 3000}
    variants = [
        Variant(AUTO.name, "", small, (120.0,), (SCENE,)),
        Variant(CLEAN.name, "", small | CLEAN.choices, (120.0,), (SCENE,)),
        Variant("elsewhere", "", {}, scenes=("traffic",)),
    ]
    monkeypatch.setattr(Variant, "config", lambda v, budget_s: config(v))
    document = bench_training(clips, variants, tmp_path, lambda stage: silent).to_json()
    assert [r["method"] for r in document["rows"]] == ["auto", "clean"]
    assert all(r["steps"] == 40 and r["seconds"] > 0 and len(r["curve"]) > 2 for r in document["rows"])
    level = document["summary"]["auto.psnr_db@120"]
    assert level == pytest.approx(document["rows"][0]["psnr_db"], abs=1e-6)
    gap = document["rows"][1]["psnr_db"] - document["rows"][0]["psnr_db"]
    assert document["summary"]["margin.clean@120"] == pytest.approx(gap, abs=1e-6)
    monkeypatch.setattr(bench, "reconstruct", lambda *a, **k: pytest.fail("ran again"))
    again = bench_training(clips, variants, tmp_path, lambda stage: silent).to_json()
    assert again["summary"] == document["summary"]
    plot_training(tmp_path / "training.png", document)
    write_run_strip(tmp_path / "strips" / "a.png", tmp_path / f"{SCENE}-3-auto-120s")
    write_sheet(tmp_path / "sheet.png", tmp_path / "strips")
    assert (tmp_path / "training.png").stat().st_size > 1000
    assert (tmp_path / "sheet.png").stat().st_size > 1000


def config(variant):
    from reconstruction.run.configuration import ReconstructionConfig

    return ReconstructionConfig(holdout="cam11", budget_s=None, steps=40, **variant.choices)


def test_every_variant_is_a_configuration_on_known_scenes():
    from acquisition.scenes.catalog import DEVELOPMENT, EVALUATION

    assert len({v.name for v in VARIANTS}) == len(VARIANTS)
    for variant in VARIANTS:
        assert set(variant.scenes) <= {*EVALUATION, *DEVELOPMENT}
        assert all(variant.config(b).budget_s == b for b in variant.budgets_s)
        if variant.name.startswith(("model.", "supervision.")):
            assert set(variant.scenes) <= set(DEVELOPMENT), "choices are made on development scenes"
    assert np.isfinite([b for v in VARIANTS for b in v.budgets_s]).all()
