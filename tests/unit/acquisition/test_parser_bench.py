"""The parser's bench counts what it parses, and refuses to time a parser that loses blocks."""

import pytest

from acquisition.devices import bench
from acquisition.devices.bench import parser_rows
from acquisition.devices.protocol import BlockParser
from acquisition.errors import DeviceError


def test_rates_are_of_blocks_that_were_found():
    rows, summary = parser_rows(16_000_000, memcpy_gb_s=10.0)
    assert [row["case"] for row in rows] == ["parser, whole blocks", "parser, cut blocks"]
    for row in rows:
        assert row["gb_s"] * 1e9 / row["blocks_per_s"] == pytest.approx(1_000_096)  # with leader and trailer
        assert row["share_of_memcpy"] == pytest.approx(row["gb_s"] / 10)
    assert summary["parser_cut_gb_s"] == rows[1]["gb_s"]


def test_a_parser_that_loses_a_block_is_not_timed(monkeypatch):
    class Forgetful(BlockParser):
        def feed(self, data):
            if bytes(data[8:9]) != b"\x05":
                super().feed(data)

    monkeypatch.setattr(bench, "BlockParser", Forgetful)
    with pytest.raises(DeviceError, match="found 15 blocks"):
        parser_rows(1, 10.0)
