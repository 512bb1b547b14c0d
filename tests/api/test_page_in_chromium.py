"""The page in a real browser, which asks for a password where API keys are on."""

import base64
import contextlib
import http.client
import json
import os
import select
import shlex
import shutil
import signal
import subprocess
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn
from pydantic import SecretStr

from api.app import create_app
from worker.settings import Settings

ADMIN_KEY = "tsk_admin_" + "k" * 40
OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --remote-debugging-pipe"
)


class Browser:
    """Headless Chromium, by its DevTools protocol on a pair of pipes: messages of JSON that end with a zero byte.

    password: the answer where it asks for one, as a person would give it; ``asked``: how often it did.
    """

    def __init__(self, folder, password: str) -> None:
        self.password = password
        self.asked = 0
        to_browser, self._to = os.pipe()
        self._from, from_browser = os.pipe()
        program = shlex.quote(shutil.which("chromium") or "")
        command = (
            f"exec {program} {OPTIONS} --user-data-dir={shlex.quote(str(folder))} 3<&{to_browser} 4>&{from_browser}"
        )
        self._process = subprocess.Popen(
            ["bash", "-c", command],
            pass_fds=[to_browser, from_browser],
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, "HOME": str(folder)},
        )
        os.close(to_browser)
        os.close(from_browser)
        self._buffer = b""
        self._number = 0
        self._session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.call("Fetch.enable", handleAuthRequests=True)
        self.call("Runtime.enable")

    def close(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        os.close(self._to)
        os.close(self._from)

    def call(self, method: str, **parameters) -> dict:
        """The result of a command; events that come meanwhile are dealt with."""
        number = self._send(method, parameters)
        deadline = time.monotonic() + 30.0
        while True:
            message = self._receive(deadline)
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._deal_with(message)

    def value(self, expression: str):
        """What a JavaScript expression in the page gives."""
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def _deal_with(self, event: dict) -> None:
        parameters = event.get("params", {})
        if event.get("method") == "Fetch.requestPaused":
            self._send("Fetch.continueRequest", {"requestId": parameters["requestId"]})
        if event.get("method") == "Fetch.authRequired":
            self.asked += 1
            answer = {"response": "ProvideCredentials", "username": "anybody", "password": self.password}
            if self.asked > 20:
                answer = {"response": "CancelAuth"}
            request = {"requestId": parameters["requestId"], "authChallengeResponse": answer}
            self._send("Fetch.continueWithAuth", request)

    def _send(self, method: str, parameters: dict) -> int:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        return self._number

    def _receive(self, deadline: float) -> dict:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, "the browser does not answer"
            chunk = os.read(self._from, 1 << 16)
            assert chunk, "the browser ended"
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(line)


@pytest.fixture
def url(settings: Settings, broker) -> Iterator[str]:
    """Address of a service with API keys on."""
    app = create_app(settings.model_copy(update={"admin_key": SecretStr(ADMIN_KEY)}), broker, sweep=False)
    server = uvicorn.Server(uvicorn.Config(app, host="127.0.0.1", port=0, log_level="warning"))
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.01)
    yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    server.should_exit = True
    thread.join(20)


@pytest.fixture
def browser(tmp_path) -> Iterator[Browser]:
    if shutil.which("chromium") is None:
        pytest.skip("needs the Debian package chromium")
    started = Browser(tmp_path / "chromium", ADMIN_KEY)
    yield started
    started.close()


def wait_for(condition, seconds=20.0):
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.needs_chromium
def test_the_page_works_with_api_keys_on(browser: Browser, url: str):
    browser.call("Page.navigate", url=url)
    wait_for(lambda: browser.value("document.getElementById('preset')?.options.length > 0"))
    wait_for(lambda: browser.value("document.getElementById('list').textContent") == "No cases yet.")
    assert browser.asked >= 1
    assert browser.value("document.getElementById('status').textContent") == ""
    browser.value("document.querySelector('#new button').click()")
    wait_for(lambda: browser.value("document.querySelectorAll('article').length") == 1)
    assert browser.value("document.querySelector('article .state').textContent") == "queued"


def test_challenges_stand_in_lines_of_their_own(url: str):
    connection = http.client.HTTPConnection(url.removeprefix("http://"))
    connection.request("GET", "/v1/simulations")
    response = connection.getresponse()
    assert response.status == 401
    assert [value.split()[0] for value in response.headers.get_all("www-authenticate")] == ["Bearer", "Basic"]
    key = base64.b64encode(f"anybody:{ADMIN_KEY}".encode()).decode()
    response.read()
    connection.request("GET", "/v1/simulations", headers={"Authorization": f"Basic {key}"})
    assert connection.getresponse().status == 200
