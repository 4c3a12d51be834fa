"""The addresses that webhooks may lead to: public addresses, and hosts that the settings name."""

import ipaddress
import socket
from collections.abc import Collection
from dataclasses import dataclass
from urllib.parse import urlsplit

from server.errors import TargetError

_TRANSLATED = ipaddress.ip_network("64:ff9b::/96")  # IPv4 addresses as NAT64 gateways write them
_PORTS = {"http": 80, "https": 443}


@dataclass(frozen=True)
class Target:
    """A URL taken apart."""

    scheme: str
    host: str
    port: int
    path: str

    @property
    def authority(self) -> str:
        """Return host and port, as a Host header has them."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return host if self.port == _PORTS[self.scheme] else f"{host}:{self.port}"

    def at(self, address: str) -> str:
        """Return the URL with an address in place of the name."""
        host = f"[{address}]" if ":" in address else address
        return f"{self.scheme}://{host}:{self.port}{self.path}"


def target_of(url: str) -> Target:
    """Take a webhook's URL apart; raises TargetError."""
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        parts, host, port = None, None, None
    if parts is None or not host or parts.scheme not in _PORTS or "@" in parts.netloc or parts.fragment:
        raise TargetError(f"found the webhook {url[:80]!r}", "http(s)://HOST[:PORT]/PATH without a user")
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    return Target(parts.scheme, host, port or _PORTS[parts.scheme], path)


def addresses_of(target: Target) -> list[str]:
    """Return the addresses of a target's name now; raises TargetError where it has none."""
    try:
        found = socket.getaddrinfo(target.host, target.port, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError) as error:
        raise TargetError(f"found no address of {target.host[:80]}", "a host that can be resolved") from error
    return [str(one[4][0]) for one in found]


def allowed_address(target: Target, addresses: list[str], hosts: Collection[str]) -> str:
    """Return the address to connect to; raises TargetError for a private one of a target not named in `hosts`."""
    if not any(_names(entry, target) for entry in hosts):
        for address in addresses:
            if not _is_public(address):
                raise TargetError(
                    f"found {target.host[:80]} at the private address {address}",
                    "a public one",
                    "name the host in SPIKE4DGS_WEBHOOK_HOSTS to allow it",
                )
    return addresses[0]


def _names(entry: str, target: Target) -> bool:
    """Return whether a name in the settings, HOST or HOST:PORT, is that of the target."""
    parts = urlsplit(f"//{entry}")
    return parts.hostname == target.host and parts.port in (None, target.port)


def _is_public(text: str) -> bool:
    address = ipaddress.ip_address(text.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and (
        (address.ipv4_mapped or address.sixtofour or address.teredo or address in _TRANSLATED)  # an IPv4 address inside
        or address.is_site_local  # fec0::/10, which Python calls global
    ):
        return False
    return address.is_global and not address.is_multicast and not address.is_reserved
