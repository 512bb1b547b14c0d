"""``tomosim keys``: made, listed, revoked; the secret is shown once."""

import pytest

from tomosim.cli import main
from worker.records.database import connect
from worker.records.keys import Keys
from worker.settings import Settings


@pytest.fixture
def keys(tmp_path, monkeypatch, backend):
    settings = Settings.load(data_folder=tmp_path, **backend)
    for name, value in settings.environment().items():
        monkeypatch.setenv(name, value)
    engine = connect(settings.resolved_database_url)
    yield Keys(engine)
    engine.dispose()


def test_create_list_revoke(keys, capsys):
    assert main(["keys", "create", "--name", "portal", "--scope", "write", "--scope", "read", "--expires", "90d"]) == 0
    secret = capsys.readouterr().out.strip()
    key = keys.find(secret)
    assert (key.name, key.scopes) == ("portal", ["read", "write"])
    assert key.expires - key.created == pytest.approx(90 * 86400, abs=60)
    assert main(["keys", "list"]) == 0
    listed = capsys.readouterr().out
    assert key.id in listed
    assert "portal" in listed
    assert secret.rpartition("_")[2] not in listed
    assert main(["keys", "revoke", key.id]) == 0
    assert keys.find(secret).revoked is not None
    assert main(["keys", "revoke", key.id]) == 2
    assert "no key" in capsys.readouterr().err


def test_defaults(keys, capsys):
    assert main(["keys", "create", "--name", "a", "--active-cases", "0", "--cases-per-day", "5"]) == 0
    key = keys.find(capsys.readouterr().out.strip())
    assert (key.scopes, key.expires, key.active_cases, key.cases_per_day) == (["read"], None, 0, 5)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--expires", "soon"],
        ["--expires", "2001-01-01"],
        ["--expires", "0d"],
        ["--scope", "all"],
        ["--active-cases", "-1"],
    ],
)
def test_what_is_wrong_is_said(keys, capsys, arguments):
    with pytest.raises(SystemExit) as end:
        main(["keys", "create", "--name", "a", *arguments])
    assert end.value.code == 2
    assert arguments[1] in capsys.readouterr().err


def test_a_date(keys, capsys):
    assert main(["keys", "create", "--name", "a", "--expires", "2999-01-31"]) == 0
    assert keys.find(capsys.readouterr().out.strip()).expires == 32474736000
