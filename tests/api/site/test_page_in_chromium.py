"""The page in a real browser, which asks for a password where API keys are on."""

import base64
import http.client
from collections.abc import Iterator
from contextlib import closing

import pytest
from pydantic import SecretStr

from api.app import create_app
from tests.support.chromium import Browser
from tests.support.servers import served
from tests.support.waiting import wait_for
from worker.settings import Settings

ADMIN_KEY = "tsk_admin_" + "k" * 40


@pytest.fixture
def url(settings: Settings, broker) -> Iterator[str]:
    """Address of a service with API keys on."""
    app = create_app(settings.model_copy(update={"admin_key": SecretStr(ADMIN_KEY)}), broker, sweep=False)
    with served(app) as address:
        yield address


@pytest.fixture
def browser(tmp_path) -> Iterator[Browser]:
    with closing(Browser(tmp_path / "chromium", ADMIN_KEY)) as started:
        yield started


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
