"""The bench of compact recordings says for every recording and every way what it measured, and checks every bit."""

import json

import numpy as np
import pytest

from acquisition.recording import compact_bench
from acquisition.recording.compact_bench import CHOSEN, bench_compact
from acquisition.spikes.compact import encode
from acquisition.spikes.layout import PlaneLayout
from acquisition.spikes.packing import pack
from acquisition.spikes.stream import SpikeStream

LAYOUT = PlaneLayout(24, 10)
OTHERS = 4 + 6  # planes and differences under two coders, trains under all but the chosen one


def stream_of(planes: int, seed: int) -> SpikeStream:
    periods = np.random.default_rng(seed).integers(2, 9, (10, 24))
    return SpikeStream(pack(np.arange(1, planes + 1)[:, None, None] % periods == 0, LAYOUT), LAYOUT, 20_000.0)


def test_it_names_recordings_and_ways():
    streams = [stream_of(450, 0), stream_of(9, 1)]
    document = bench_compact({"rec": streams, "other": streams[:1]}).to_json()
    assert json.loads(json.dumps(document)) == document
    own = [row for row in document["rows"] if row["method"] == CHOSEN]
    assert [(row["recording"], row["cameras"], row["bytes"]) for row in own] == [
        ("rec", 2, 459 * 30),
        ("other", 1, 450 * 30),
    ]
    assert len(document["rows"]) == 2 + 2 * OTHERS
    assert all(row["seconds"] > 0 for row in document["rows"])
    written = sum(len(encode(part)) for part in (streams[0].packed[:400], streams[0].packed[400:], streams[1].packed))
    assert document["summary"]["rec.ratio"] == pytest.approx(459 * 30 / written)
    assert {"rec.plane_ms", "other.read_mb_s", f"{CHOSEN}.write_mb_s", "planes, zstd 3.ratio"} <= set(
        document["summary"]
    )


def test_ways_that_lose_a_bit_are_not_timed(monkeypatch):
    monkeypatch.setattr(compact_bench, "decode", lambda *_: np.zeros((9, 30), dtype=np.uint8))
    with pytest.raises(AssertionError):
        bench_compact({"rec": [stream_of(9, 1)]})
