"""The paper's protocol as data: nothing of the paper is forgotten, and every cell can be run."""

import pytest
from maintenance.beside_the_paper import BESIDE, IMAGE_ROWS, POSE_ROWS

from acquisition.scenes.catalog import DEVELOPMENT_SEEDS, EVALUATION_SEEDS, SCENES, STRESS
from reconstruction.bench.conventions import VIEWS, seed_of
from reconstruction.bench.paper.method import Cell, Effort, Method
from reconstruction.bench.paper.methods import APART, AUTO, LOSSES, NOMINAL
from reconstruction.bench.paper.protocol import PROTOCOL, QUICK
from reconstruction.bench.paper.protocol import SCENES as SHOWN
from reconstruction.bench.paper.published import IMAGE_MODELS, PUBLISHED, QUICK_MODELS, SPIKE_MODELS
from reconstruction.bench.paper.tables import HOW
from reconstruction.bench.rivals.bench import ROWS as RIVALS
from reconstruction.errors import BadRunError
from reconstruction.methods.catalogue import METHODS, OURS
from reconstruction.run.configuration import SUPERVISIONS
from rigs.toml import catalog_rig

TABLES = {table.name: table for table in PROTOCOL.tables}


def test_every_line_of_the_paper_has_a_row_of_ours_or_a_reason_why_not():
    beside = {"images": {r.paper for r in IMAGE_ROWS}, "poses": {r.paper for r in POSE_ROWS}}
    for table in PROTOCOL.tables:
        beside[table.name] = {row.paper for row in table.rows}
    of_novel_view = [table.rows for table in PROTOCOL.tables if table.name not in PUBLISHED]
    beside["novel-view"] = {row.paper for rows in (*of_novel_view, RIVALS) for row in rows}
    published = PUBLISHED | {name: lines for name, (_, lines) in BESIDE.items()}
    for name, lines in published.items():
        assert set(lines) - beside[name] == set(), name
    for rows in (IMAGE_ROWS, POSE_ROWS):
        assert all(bool(row.keys) != bool(row.omitted) for row in rows)
    for table in (*PROTOCOL.tables, *QUICK.tables):
        assert all((row.method is None) == bool(row.omitted) for row in table.rows)


def test_what_stands_beside_a_row_is_published():
    for table in (*PROTOCOL.tables, *QUICK.tables):
        known = PUBLISHED.get(table.name, {}) | PUBLISHED["novel-view"]
        assert all(row.paper in known for row in table.rows if row.paper)
    assert all(
        set(figures) <= set(HOW)
        for lines in (*PUBLISHED.values(), *(lines for _, lines in BESIDE.values()))
        for figures in lines.values()
    )
    assert PUBLISHED["novel-view"]["Spike4DGS"] == {"psnr_db": 27.74, "ssim": 0.912, "seconds": 1500}
    assert PUBLISHED["views"]["TFI + STG, 5 views"] == {"brisque": 57.0, "niqe": 16.7}


@pytest.mark.parametrize("protocol", [PROTOCOL, QUICK])
def test_every_cell_is_a_configuration_and_no_two_share_a_name(protocol):
    cells, ids = protocol.cells(), catalog_rig("lab3x3").ids
    by_name: dict[str, Method] = {}
    for cell in cells:
        assert by_name.setdefault(cell.method.name, cell.method) == cell.method
        config = cell.method.config(cell.effort, cell.seed)
        assert (config.holdout, config.seed) == ("cam11", cell.seed)
        assert (config.budget_s, config.steps) == (cell.effort.budget_s, cell.effort.steps)
        assert set(config.views) <= set(ids)
    assert len({cell.name for cell in cells}) == len(cells)


@pytest.mark.parametrize("protocol", [PROTOCOL, QUICK])
def test_every_row_is_run_and_every_batch_is_of_rows_and_scenes_that_exist(protocol):
    for batch in protocol.batches:
        table = next(t for t in protocol.tables if t.name == batch.table)
        assert set(batch.methods) <= {row.method.name for row in table.rows if row.method}
        assert set(batch.scenes) <= set(SCENES)
    for table in protocol.tables:
        for row in table.rows:
            assert bool(protocol.wanted(table, row)) == (row.method is not None), row.label


def test_what_matters_most_comes_first_and_every_table_has_one_length():
    tables = list(dict.fromkeys(batch.table for batch in PROTOCOL.batches))
    assert tables[:6] == ["stress", "outdoors", "static", "views", "rates", "references"]
    assert len(tables) == len(PROTOCOL.batches) == len(PROTOCOL.tables)
    assert {cell.scene for cell in PROTOCOL.cells()} == {*SHOWN, *STRESS}
    assert {cell.seed for cell in PROTOCOL.cells()} == set(EVALUATION_SEEDS[:1])


def test_the_chain_and_ours_are_changed_a_part_at_a_time():
    for table, most in ((TABLES["chain"], 4), (TABLES["modules"], 3)):
        first, *rest = [row.method for row in table.rows if row.method]
        for method in rest:
            assert method.change == first.change == NOMINAL
            asked = method.choices.keys() | first.choices.keys()
            other = {key for key in asked if method.choices.get(key) != first.choices.get(key)}
            assert 0 < len(other) <= most, method.name


def test_a_part_of_the_protocol_by_table_and_scene():
    part = PROTOCOL.of(("depth", "rates")).on(("static",))
    assert [table.name for table in part.tables] == ["depth", "rates"]
    assert {cell.scene for cell in part.cells()} == {"static"}
    with pytest.raises(BadRunError, match=r"found the tables deep, expected some of chain, modules"):
        PROTOCOL.of(("deep",))
    with pytest.raises(BadRunError, match=r"found the scenes nowhere, expected some of fan_and_ball"):
        PROTOCOL.on(("nowhere",))


def test_the_first_seed_is_the_one_of_every_other_bench():
    assert [seed_of("traffic", n) for n in range(3)] == list(EVALUATION_SEEDS)
    assert seed_of("fan_and_ball", 0) == seed_of("sky", 0) == DEVELOPMENT_SEEDS[1]
    assert {seed_of("fan_and_ball", n) for n in range(3)} == set(DEVELOPMENT_SEEDS)


def test_names_say_how_long():
    assert str(Effort(30.0)) == "30 s"
    assert str(Effort(steps=40)) == "40 steps"
    assert Cell(Method("auto"), "fan", 101, Effort(7.5)).name == "fan-101-auto-7.5"


def test_every_baseline_is_a_published_model_or_a_smaller_one():
    known = {*IMAGE_MODELS.values(), *QUICK_MODELS.values(), *SPIKE_MODELS.values()}
    assert known == set(METHODS) - {method.name for method in OURS}
    assert IMAGE_MODELS.keys() == QUICK_MODELS.keys()


def test_every_spike_loss_has_a_row():
    assert set(SUPERVISIONS) - set(APART) == set(LOSSES)
    assert TABLES["losses"].rows[0].method == AUTO


def test_the_nearest_views_come_first():
    assert VIEWS == ("cam01", "cam10", "cam12", "cam21", "cam00", "cam02", "cam20", "cam22")
