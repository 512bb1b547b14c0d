"""Which hosts may be destinations (TOMOSIM_DESTINATION_HOSTS), and the address a name stands for."""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Sequence

from simcore.core.errors import SimulationError
from worker.settings import network_of

Address = ipaddress.IPv4Address | ipaddress.IPv6Address


class DestinationNotAllowed(SimulationError):
    """The destination lies outside of what the operator allows."""

    kind = "user"
    code = "destination-not-allowed"


def require_allowed(host: str, allowed: Sequence[str]) -> bool:
    """Whether the name itself is allowed; where only its address can tell, ``resolve`` will.

    raises: DestinationNotAllowed where no entry can allow it
    """
    if not allowed or any(_matches_name(host, entry) for entry in allowed):
        return True
    networks = [network for entry in allowed if (network := network_of(entry)) is not None]
    address = _address(host)
    if address is not None and any(address in network for network in networks):
        return True
    if address is None and networks:
        return False
    raise _refusal(host, None, allowed)


def resolve(host: str, port: int, allowed: Sequence[str]) -> str:
    """The address to connect to: looked up once, so that what was checked is what is used.

    raises: DestinationNotAllowed; OSError where the name is not known
    """
    by_name = require_allowed(host, allowed)
    entries = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    addresses = [str(item[4][0]) for item in sorted(entries, key=lambda item: item[0] != socket.AF_INET)]
    if by_name:
        return addresses[0]
    networks = [network for entry in allowed if (network := network_of(entry)) is not None]
    for address in addresses:
        if any(ipaddress.ip_address(address.partition("%")[0]) in network for network in networks):
            return address
    raise _refusal(host, addresses[0], allowed)


def _matches_name(host: str, entry: str) -> bool:
    name, pattern = host.lower().rstrip("."), entry.lower().rstrip(".")
    return name == pattern or (pattern.startswith("*.") and name.endswith(pattern[1:]))


def _address(host: str) -> Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _refusal(host: str, address: str | None, allowed: Sequence[str]) -> DestinationNotAllowed:
    what = host if address is None or address == host else f"{host} ({address})"
    return DestinationNotAllowed(
        f"host = {what!r} is not among the destinations that this service allows: {', '.join(allowed)}; ask whoever "
        "runs it to add the host to TOMOSIM_DESTINATION_HOSTS"
    )
