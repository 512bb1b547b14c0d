"""Headless Chromium for tests, by its DevTools protocol."""

import contextlib
import json
import os
import select
import shlex
import signal
import subprocess
import time

from tests.support.services import need

OPTIONS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync --disable-dev-shm-usage --remote-debugging-pipe"
)


class Browser:
    """Headless Chromium, by its DevTools protocol on a pair of pipes: messages of JSON that end with a zero byte.

    raises: Missing where it is not installed
    password: the answer where it asks for one, as a person would give it; ``asked``: how often it did.
    """

    def __init__(self, folder, password: str) -> None:
        self.password = password
        self.asked = 0
        to_browser, self._to = os.pipe()
        self._from, from_browser = os.pipe()
        program = shlex.quote(need("chromium", "chromium"))
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
