"""Requests to addresses that users name (webhooks): only to public addresses, by https, without redirects.

A name is looked up once; every address it has must be allowed, and the connection goes to one of exactly these, so
that a name that points elsewhere a moment later leads nowhere. The certificate is still checked against the name.
"""

from __future__ import annotations

import ipaddress
import re
import socket
import ssl
import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache

import anyio
import certifi
import httpx

from simcore.core.errors import SimulationError

CONNECT_SECONDS = 5.0
TOTAL_SECONDS = 15.0
MAX_URL_LENGTH = 2000
MAX_ADDRESSES = 3
"""A name may have many addresses; no more are tried."""

EXCERPT_BYTES = 1024
"""So much of an answer is read."""

Address = ipaddress.IPv4Address | ipaddress.IPv6Address

_HOST = re.compile(rb"[0-9A-Za-z._-]+|[0-9a-fA-F:.]+")
_UNICAST_V6 = ipaddress.IPv6Network("2000::/3")
# Global by the registries' words, but services of cloud providers for the machine itself answer there.
_METADATA = (ipaddress.IPv4Network("192.0.0.0/24"), ipaddress.IPv4Network("168.63.129.16/32"))


class RefusedAddressError(SimulationError):
    """A URL leads where requests must not go; the message says what is allowed."""

    kind = "user"
    code = "address-refused"


@dataclass(frozen=True)
class Answer:
    """status: of HTTP, None where none came. error: why it is no success. excerpt: the beginning of the body."""

    status: int | None
    error: str
    excerpt: str
    seconds: float

    @property
    def ok(self) -> bool:
        return not self.error


def is_public(address: Address) -> bool:
    """Whether an address belongs to the public internet: no private network, no loopback, no link, no metadata."""
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return is_public(address.ipv4_mapped)
        # Tunnels and translators (6to4, Teredo, NAT64) could lead to any IPv4 address.
        if address not in _UNICAST_V6 or address.sixtofour is not None or address.teredo is not None:
            return False
    elif any(address in network for network in _METADATA):
        return False
    return address.is_global and not address.is_multicast


def check_url(text: str, private_hosts: Collection[str] = ()) -> httpx.URL:
    """A URL that may be asked for, as far as it can be told without looking its name up.

    private_hosts: names or addresses that may be private and may be reached by http.
    raises: RefusedAddressError
    """
    try:
        url = httpx.URL(text)
        port = url.port
    except httpx.InvalidURL as error:
        raise RefusedAddressError(f"url = {text[:200]!r}: {error}") from None
    shown = f"url = {text[:200]!r}"
    if len(text) > MAX_URL_LENGTH:
        raise RefusedAddressError(f"{shown}: no longer than {MAX_URL_LENGTH} characters")
    if url.scheme not in ("https", "http") or not _is_host(url.raw_host):
        raise RefusedAddressError(f"{shown}: it must begin with https:// and a host")
    if url.userinfo or url.fragment:
        raise RefusedAddressError(f"{shown}: neither a user nor a fragment (#...) may stand in it")
    if port is not None and not 1 <= port <= 65535:
        raise RefusedAddressError(f"{shown}: the port must be 1 to 65535")
    if url.host in private_hosts:
        return url
    if url.scheme != "https":
        raise RefusedAddressError(f"{shown}: it must begin with https:// ({_HOW_TO_ALLOW})")
    try:
        literal = ipaddress.ip_address(url.host)
    except ValueError:
        return url
    _require_public(url.host, literal)
    return url


def _is_host(raw: bytes) -> bool:
    """Whether a name can be looked up: labels of 1 to 63 characters."""
    try:
        raw.decode("ascii").encode("idna")
    except UnicodeError:
        return False
    return _HOST.fullmatch(raw) is not None


_HOW_TO_ALLOW = "hosts of an intranet are named in TOMOSIM_WEBHOOK_PRIVATE_HOSTS"


def _require_public(host: str, address: Address) -> None:
    if not is_public(address):
        raise RefusedAddressError(f"{host} is {address}, which is not a public address ({_HOW_TO_ALLOW})")


async def lookup(host: str, port: int) -> list[Address]:
    """The addresses of a name. raises: OSError"""
    entries = await anyio.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    return [ipaddress.ip_address(str(entry[4][0]).partition("%")[0]) for entry in entries]


async def resolve(url: httpx.URL, private_hosts: Collection[str] = ()) -> list[Address]:
    """The addresses to connect to. raises: RefusedAddressError where any of them is not allowed; OSError"""
    # The name as it stands in the certificate: other ways to write it could be looked up differently.
    addresses = await lookup(url.raw_host.decode("ascii"), url.port or (443 if url.scheme == "https" else 80))
    if url.host not in private_hosts:
        for address in addresses:
            _require_public(url.host, address)
    return addresses[:MAX_ADDRESSES]


async def post(text: str, content: bytes, headers: Mapping[str, str], private_hosts: Collection[str] = ()) -> Answer:
    """Sends ``content`` and tells what came back; never raises for what the other side does."""
    start = time.monotonic()
    status: int | None = None
    excerpt = error = ""
    try:
        with anyio.fail_after(TOTAL_SECONDS):
            url = check_url(text, private_hosts)
            status, excerpt = await _post(url, await resolve(url, private_hosts), content, headers)
        if 300 <= status < 400:
            error = f"it answered {status}; redirects are not followed: name the final address"
        elif not 200 <= status < 300:
            error = f"it answered {status}"
    except TimeoutError:
        error = f"no answer within {TOTAL_SECONDS:g} s"
    except RefusedAddressError as refused:
        error = str(refused)
    except (httpx.HTTPError, OSError, ValueError) as failed:
        error = f"{type(failed).__name__}: {failed}" if str(failed) else type(failed).__name__
    return Answer(status, error, excerpt, round(time.monotonic() - start, 3))


async def _post(
    url: httpx.URL, addresses: list[Address], content: bytes, headers: Mapping[str, str]
) -> tuple[int, str]:
    timeout = httpx.Timeout(TOTAL_SECONDS, connect=CONNECT_SECONDS)
    async with httpx.AsyncClient(verify=_certificates(), trust_env=False, timeout=timeout) as client:
        for number, address in enumerate(addresses, 1):
            pinned = url.copy_with(host=str(address))
            request = client.build_request(
                "POST",
                pinned,
                content=content,
                headers={**headers, "Host": url.netloc.decode("ascii")},
                extensions={"sni_hostname": url.raw_host.decode("ascii")},
            )
            try:
                response = await client.send(request, stream=True, follow_redirects=False)
            except httpx.ConnectError:
                if number == len(addresses):
                    raise
                continue
            try:
                return response.status_code, await _excerpt(response)
            finally:
                await response.aclose()
    raise OSError(f"{url.host} has no address")


async def _excerpt(response: httpx.Response) -> str:
    body = b""
    async for chunk in response.aiter_raw():  # as it comes: unpacking could make much of little
        body += chunk
        if len(body) >= EXCERPT_BYTES:
            break
    return body[:EXCERPT_BYTES].decode("utf-8", "replace").replace("\0", "")


@cache
def _certificates() -> ssl.SSLContext:
    """Those of the machine (an intranet's own among them) and those that come with the client."""
    context = ssl.create_default_context()
    context.load_verify_locations(certifi.where())
    return context
