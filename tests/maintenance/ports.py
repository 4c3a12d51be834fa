"""Ports for servers that are killed and started again at the same address."""

import random
import socket

_PORTS = range(20_000, 32_000)  # below those from which a system dials out, which could take one in between


def free_port() -> int:
    """Return a port of loopback that nobody listens on."""
    while True:
        port = random.SystemRandom().choice(_PORTS)
        try:
            socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            continue
        return port
