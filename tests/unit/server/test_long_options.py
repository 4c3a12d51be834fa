"""Options of the bench of long recordings, and the clips that it makes."""

import json

import pytest

from acquisition.progress import silent
from acquisition.scenes.catalog import (
    DEVELOPMENT_SEEDS,
    EVALUATION_SEEDS,
    LONG_DEVELOPMENT,
    LONG_EVALUATION,
    REALISTIC_LONG,
)
from reconstruction.bench.long.bench import LongBench
from server.cli.bench_asked import Asked


@pytest.fixture
def chosen(unrun, tmp_path):
    """Make the bench that options ask for, beside an earlier document."""
    return lambda **options: unrun(
        LongBench, "long", Asked(tmp_path, lambda _: silent, tmp_path / "long.json", **options)
    )


def test_only_development_scenes_are_as_long_as_they_may(chosen):
    shorter = [f"{scene}-4000" for scene in (LONG_DEVELOPMENT[0], *LONG_EVALUATION, *REALISTIC_LONG)]
    assert [clip.name for clip in chosen().clips] == [*shorter, f"{LONG_DEVELOPMENT[0]}-20000"]
    assert [clip.name for clip in chosen(scenes="pushed_blocks").clips] == ["pushed_blocks-4000"]
    assert [clip.planes for clip in chosen(quick=True).clips] == [1200]


def test_evaluation_scenes_have_seeds_of_their_own(chosen):
    seeds = {clip.scene: clip.seed for clip in chosen().clips}
    assert {seeds[scene] for scene in LONG_EVALUATION} == {EVALUATION_SEEDS[0]}
    assert {seeds[scene] for scene in seeds.keys() - set(LONG_EVALUATION)} == {DEVELOPMENT_SEEDS[0]}


def test_an_earlier_document_is_handed_on(chosen, tmp_path):
    assert list(chosen().earlier) == []
    (tmp_path / "long.json").write_text(json.dumps({"rows": [{"clip": "a"}]}))
    assert list(chosen().earlier) == [{"clip": "a"}]
