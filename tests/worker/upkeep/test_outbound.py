"""Where requests to addresses of users may go: nowhere inside, by no trick."""

import ipaddress
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import anyio
import pytest

from worker.upkeep import outbound
from worker.upkeep.outbound import RefusedAddressError


def post(url, private=()):
    return anyio.run(outbound.post, url, b"{}", {"Content-Type": "application/json"}, private)


@pytest.fixture
def names(monkeypatch):
    """Answers of the name service: {host: [[addresses of the first look], [of the second], ...]}."""
    answers = {}
    looked = []

    async def lookup(host, port):
        looked.append(host)
        try:
            literal = ipaddress.ip_address(host)
        except ValueError:
            addresses = answers[host].pop(0) if len(answers[host]) > 1 else answers[host][0]
            return [ipaddress.ip_address(a) for a in addresses]
        return [literal]

    monkeypatch.setattr(outbound, "lookup", lookup)
    return answers


@pytest.fixture
def receiver():
    """A server on loopback that answers what its path says and remembers what it got."""
    got = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self):
            body = self.rfile.read(int(self.headers["Content-Length"]))
            got.append((self.path, dict(self.headers), body))
            self.send_response(int(self.path.strip("/") or 200))
            if self.path == "/302":
                self.send_header("Location", "/200")
            self.end_headers()
            self.wfile.write(b"x" * 100_000 if self.path == "/200" else b"")

        def log_message(self, *args):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    server.got = got
    yield server
    server.shutdown()
    server.server_close()


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1",
        "127.8.9.1",
        "0.0.0.0",
        "10.0.0.1",
        "172.16.0.1",
        "192.168.1.1",
        "100.64.0.1",
        "169.254.169.254",
        "192.0.0.192",
        "168.63.129.16",
        "198.18.0.1",
        "224.0.0.1",
        "255.255.255.255",
        "::",
        "::1",
        "::127.0.0.1",
        "::ffff:127.0.0.1",
        "::ffff:169.254.169.254",
        "64:ff9b::a9fe:a9fe",
        "2002:7f00:1::",
        "2001:0:53aa:64c::1",
        "fe80::1",
        "fec0::1",
        "fd00:ec2::254",
        "ff02::1",
        "2001:db8::1",
    ],
)
def test_addresses_inside(address):
    assert not outbound.is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize("address", ["93.184.216.34", "8.8.8.8", "2606:4700::1111", "::ffff:8.8.8.8"])
def test_addresses_outside(address):
    assert outbound.is_public(ipaddress.ip_address(address))


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("http://example.org/", "https://"),
        ("ftp://example.org/", "https://"),
        ("//example.org/", "https://"),
        ("https:///path", "host"),
        ("https://a..b/", "host"),
        ("https://./", "host"),
        ("https://" + "x" * 64 + ".org/", "host"),
        ("https://user:password@example.org/", "user"),
        ("https://example.org/#part", "fragment"),
        ("https://example.org:0/", "port"),
        ("https://example.org:99999/", "ort"),
        ("https://127.0.0.1/", "not a public address"),
        ("https://[::1]/", "not a public address"),
        ("https://[::ffff:10.0.0.1]/", "not a public address"),
        ("https://example.org/" + "x" * 2000, "2000"),
        ("https://exa mple.org/", "https://exa mple.org/"),
    ],
)
def test_urls_that_are_refused(url, words):
    with pytest.raises(RefusedAddressError, match=r".*") as refused:
        outbound.check_url(url)
    assert words in str(refused.value)


def test_a_named_host_may_be_private_and_without_tls(receiver):
    url = f"http://127.0.0.1:{receiver.server_port}/200"
    assert "https://" in post(url).error
    assert receiver.got == []
    answer = post(url, {"127.0.0.1"})
    assert (answer.status, answer.ok) == (200, True)
    assert answer.excerpt == "x" * outbound.EXCERPT_BYTES  # and no more


@pytest.mark.parametrize("disguise", ["localhost", "127.1", "2130706433", "0x7f.1"])
def test_names_of_this_machine(disguise):
    assert "not a public address" in post(f"https://{disguise}/").error


def test_one_private_address_is_enough_to_refuse(names):
    names["two.example"] = [["93.184.216.34", "10.0.0.1"]]
    assert "10.0.0.1" in post("https://two.example/").error


def test_a_name_that_changes_is_asked_once(names, receiver, monkeypatch):
    """DNS rebinding: public when it is checked, private when it is connected to."""
    names["rebind.example"] = [["203.0.113.1"], ["127.0.0.1"]]
    monkeypatch.setattr(outbound, "is_public", lambda address: not address.is_loopback)
    monkeypatch.setattr(outbound, "CONNECT_SECONDS", 0.2)
    answer = post(f"https://rebind.example:{receiver.server_port}/200")
    assert not answer.ok
    assert receiver.got == []


def test_the_connection_goes_to_the_checked_address_under_the_name(names, receiver):
    names["hooks.intranet"] = [["127.0.0.1"]]
    answer = post(f"http://hooks.intranet:{receiver.server_port}/200", {"hooks.intranet"})
    assert answer.ok
    assert receiver.got[0][1]["Host"] == f"hooks.intranet:{receiver.server_port}"


def test_redirects_are_not_followed(receiver):
    answer = post(f"http://127.0.0.1:{receiver.server_port}/302", {"127.0.0.1"})
    assert answer.status == 302
    assert "redirect" in answer.error
    assert len(receiver.got) == 1


def test_nobody_there(free_port):
    answer = post(f"http://127.0.0.1:{free_port}/", {"127.0.0.1"})
    assert answer.status is None
    assert "ConnectError" in answer.error


def test_a_receiver_that_never_answers_is_left(monkeypatch):
    monkeypatch.setattr(outbound, "TOTAL_SECONDS", 0.3)
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen()
        answer = post(f"http://127.0.0.1:{silent.getsockname()[1]}/", {"127.0.0.1"})
    assert "no answer within 0.3 s" in answer.error
