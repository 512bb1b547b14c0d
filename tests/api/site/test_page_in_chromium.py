"""The page in a real browser, which asks for a password where API keys are on."""

import base64
import http.client
import shutil
import threading
import time
from collections.abc import Iterator

import pytest
import uvicorn
from pydantic import SecretStr

from api.app import create_app
from worker.settings import Settings

from ..chromium import Browser

ADMIN_KEY = "tsk_admin_" + "k" * 40


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
    shown = browser.value("cautions({cautions: ['a < b', 'c']}).map(node => node.textContent).join('|')")
    assert shown == "a < b|c"


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
