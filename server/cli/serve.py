"""`serve` runs the web service, `worker` its queued work."""

import logging
import re
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, nullcontext, suppress
from typing import Any

import click

from rigs.errors import Spike4dgsError
from server.cli.options import data_folder, several

KINDS = ("captures", "reconstructions", "tasks")


class PortError(Spike4dgsError):
    """An address the service cannot listen on."""

    exit_code = 2


def parse_name(text: str) -> str:
    """Return the name that `text` is, of a worker or token."""
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,62}", text):
        raise click.BadParameter(f"found {text[:70]!r}, expected letters, digits, dots and dashes, at most 63")
    return text


def _queues(text: str) -> tuple[str, ...]:
    kinds = tuple(part.strip() for part in text.split(","))
    if not set(kinds) <= set(KINDS):
        raise click.BadParameter(f"found {text[:70]!r}, expected some of {','.join(KINDS)}")
    return kinds


_shared_options = several(
    data_folder,
    click.option("--rig", help="A rig's name in the catalogue or a RIG.toml.  [default: lab3x3]"),
    click.option("--devices", help="The cameras: usb:, mock:SCENE or replay:REC.  [default: usb:]"),
    click.option("--log", type=click.Choice(["text", "json"]), help="Form of the log.  [default: text]"),
    click.option("--otel", metavar="URL", help="Send traces to this OpenTelemetry collector (OTLP over HTTP)."),
)


@click.command()
@click.option("--host", help="Address to listen on; one that others reach needs a token.  [default: 127.0.0.1]")
@click.option("--port", type=click.IntRange(0, 65535), help="0 takes any free one.  [default: 8000]")
@click.option("--allow-host", "hosts", multiple=True, metavar="NAME[:PORT]", help="A host name that requests may use.")
@click.option(
    "--allow-origin",
    "origins",
    multiple=True,
    metavar="URL",
    help="A page that may send requests, such as https://lab.example.",
)
@_shared_options
@click.option("--with-worker", is_flag=True, help="Run a worker too: keep it running, and stop it with the service.")
def serve_command(
    host: str | None,
    port: int | None,
    hosts: tuple[str, ...],
    origins: tuple[str, ...],
    with_worker: bool,
    **shared: Any,
) -> None:
    """Serve the page and REST, on loopback unless told otherwise. The first line printed is the address."""
    from server.app import create_app
    from server.hosting import server_of
    from server.services.access import AccessService
    from server.settings import settings_of
    from server.store.store import Store
    from server.work.keeper import Keeper

    names = {"hosts": hosts or None, "origins": origins or None}
    settings = settings_of(host=host, port=port, **names, **shared)
    if settings.exposed:
        with closing(Store(settings)) as store:
            AccessService(store.tokens, settings).check_exposure()
        logging.getLogger(__name__).warning(
            "tokens reach this service in clear: put a proxy with TLS before it, as the guide describes"
        )
    with listening(settings.host, settings.port) as listener:
        flags = shared | {"data": settings.data}
        arguments = [text for name, value in flags.items() if value is not None for text in (f"--{name}", str(value))]
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        worker = [sys.executable, "-P", "-m", "server.cli", "worker", *arguments]
        keeper = Keeper(worker, settings.grace_s + 5) if with_worker else None
        app = create_app(settings, keeper)
        with keeper.running() if keeper else nullcontext():
            address = f"[{settings.host}]" if ":" in settings.host else settings.host
            click.echo(f"http://{address}:{listener.getsockname()[1]}")
            sys.stdout.flush()
            with suppress(KeyboardInterrupt):  # the usual way to stop it
                server_of(app, settings).run(sockets=[listener])


@click.command()
@_shared_options
@click.option(
    "--name",
    type=parse_name,
    metavar="NAME",
    default="worker-0",
    show_default=True,
    help="Unique among the workers of a service.",
)
@click.option(
    "--queues",
    type=_queues,
    metavar="KIND,...",
    default=",".join(KINDS),
    show_default=True,
    help="The queues it serves.",
)
@click.option("--gpu", type=click.IntRange(min=0), help="The accelerator it trains on, one job at a time on this host.")
def worker_command(name: str, queues: tuple[str, ...], gpu: int | None, **shared: Any) -> None:
    """Run captures and jobs of a data folder until stopped."""
    from server.settings import settings_of
    from server.work.worker import run_worker

    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    run_worker(settings_of(gpu=gpu, **shared), name, queues, stop)


@contextmanager
def listening(host: str, port: int) -> Iterator[socket.socket]:
    """Yield a socket that listens already, so that no early request is refused.

    The socket names its protocol, TCP: only then does the event loop send small pieces at once (TCP_NODELAY), and an
    answer need not wait 40 ms for its body. Raises PortError if the port is taken.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
        except OSError as error:
            reason = (error.strerror or "refused").lower()
            raise PortError(f"found port {port} on {host}: {reason}", do="stop what uses it or pass --port") from error
        listener.listen(128)
        yield listener
