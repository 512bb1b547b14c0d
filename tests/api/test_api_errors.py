"""Error codes: what the code says and what docs/errors.md tells are the same; HEAD; a database that is gone."""

import ast
import re
from pathlib import Path

import pytest
from sqlalchemy.exc import OperationalError

from api.http import errors
from worker.records.jobs import Jobs

ROOT = Path(__file__).parents[2]


def codes_in(path: Path) -> set[tuple[int, str]]:
    """(status, code) of every ApiError that a file makes of two constants."""
    calls = (
        node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call) and len(node.args) > 1
    )
    codes = set()
    for call in calls:
        name = getattr(call.func, "id", getattr(call.func, "attr", ""))
        status, code = call.args[:2]
        if name == "ApiError" and isinstance(status, ast.Constant) and isinstance(code, ast.Constant):
            codes.add((status.value, code.value))
    return codes


def test_every_code_is_documented():
    in_code = set().union(*(codes_in(path) for path in (ROOT / "api").rglob("*.py")))
    in_code |= {(status, code) for status, code in errors._CODES.items()}
    in_code |= {(422, "resource-limit"), (409, "already-finished"), (404, "simulation-not-found")}
    table = re.findall(r"^\| (\d{3}) \| `([a-z-]+)` \|", (ROOT / "docs" / "errors.md").read_text(), re.MULTILINE)
    documented = {(int(status), code) for status, code in table}
    assert in_code - documented == set()
    assert {code for _, code in documented - in_code} <= {f"{what}-not-found" for what in errors_of_rows()}


def errors_of_rows() -> set[str]:
    """What NotFoundError can name."""
    text = "".join(path.read_text() for folder in ("api", "worker") for path in (ROOT / folder).rglob("*.py"))
    return set(re.findall(r'NotFoundError\(\w+, "(\w+)"\)', text)) | set(re.findall(r'\bwhat = "(\w+)"', text))


def test_a_database_that_does_not_answer(client, is_problem, monkeypatch):
    def gone(*_):
        raise OperationalError("SELECT password", {}, ConnectionError())

    monkeypatch.setattr(Jobs, "page", gone)
    refused = client.get("/v1/simulations")
    problem = is_problem(refused, 503, "database-unavailable")
    assert refused.headers["retry-after"]
    assert "password" not in str(problem)


@pytest.mark.parametrize("path", ["/v1/presets", "/livez", "/", "/docs", "/openapi.json", "/v1/simulations", "/none"])
def test_head_is_get_without_the_body(client, path):
    head, get = client.head(path), client.get(path)
    assert head.status_code == get.status_code
    assert head.content == b""
    assert head.headers["content-type"] == get.headers["content-type"]
    if path != "/none":  # whose body has the identifier of the request
        assert head.headers["content-length"] == get.headers["content-length"]


def test_head_of_streams_ends_at_once(client, done, post):
    assert client.head(f"{done}/archive").headers["content-type"] == "application/zip"
    assert client.head(post()["links"]["events"]).headers["content-type"].startswith("text/event-stream")


def test_head_where_there_is_no_get(client, post, is_problem):
    refused = client.head(post()["links"]["cancel"])
    assert refused.status_code == 405
    assert refused.headers["allow"] == "POST"
    assert client.put("/v1/simulations").headers["allow"] == "GET, HEAD, POST"
