"""A service under many clients: nobody is refused or forgotten while a stage burns a core."""

import asyncio
import socket
from pathlib import Path

import pytest
from maintenance.load import run_load, summarise

from server.cli.serve import listening


def test_figures_of_known_answers() -> None:
    answers = [("job", 200, n / 1e3) for n in range(1, 101)] + [("sse", 500, 0.2), ("event", 200, 0.1)]
    rows, summary = summarise(answers)
    assert rows[1] == {"kind": "job", "number": 100, "p50_ms": 51.0, "p95_ms": 96.0, "p99_ms": 100.0, "most_ms": 100.0}
    assert [row["kind"] for row in rows] == ["event", "job", "sse"]
    assert (summary["requests"], summary["events"]) == (101, 1)
    assert (summary["answers.200"], summary["answers.500"]) == (100, 1)


def test_an_answer_in_two_pieces_does_not_wait_for_the_first_to_be_acknowledged() -> None:
    """Nagle's algorithm and a client's delayed acknowledgement would make 40 ms of it."""
    found: list[int] = []

    async def main(listener: socket.socket) -> None:
        async def answer(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            found.append(writer.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            writer.close()

        async with await asyncio.start_server(answer, sock=listener.dup()):
            reader, writer = await asyncio.open_connection(*listener.getsockname())
            assert await reader.read() == b""
            writer.close()

    with listening("127.0.0.1", 0) as listener:
        asyncio.run(main(listener))
    assert found[0] != 0


@pytest.mark.slow
@pytest.mark.long
def test_twenty_clients_are_answered(tmp_path: Path) -> None:
    document = run_load(tmp_path / "data", clients=20, seconds=5.0, jobs=30, step_s=0.02)
    answers = {name: number for name, number in document.summary.items() if name.startswith("answers.")}
    assert set(answers) == {"answers.200"}, answers
    assert {row["kind"] for row in document.rows} == {"listing", "job", "download", "sse", "stream", "event"}
    assert answers["answers.200"] == document.summary["requests"]
