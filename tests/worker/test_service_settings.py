"""Settings: defaults that work, refusals that name the variable."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from worker.records import schema
from worker.records.database import connect
from worker.records.keys import Keys, check_address
from worker.serve.processes import environment
from worker.settings import MAX_SOCKET_PATH, Settings, SettingsError, is_loopback

pytestmark = pytest.mark.embedded


def test_defaults_need_nothing(make_settings):
    settings = make_settings()
    assert settings.host == "127.0.0.1"
    assert settings.resolved_database_url == f"sqlite:///{settings.data_folder}/tomosim.db"
    assert settings.resolved_broker_url == f"redis+socket://{settings.broker_folder}/socket?virtual_host=0"
    assert settings.threads >= 1
    assert settings.visibility_timeout > settings.job_timeout_seconds


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "::", "example.org"])
def test_only_loopback_without_keys(make_settings, host):
    engine = connect("sqlite://")
    schema.upgrade(engine)
    keys = Keys(engine)
    with pytest.raises(SettingsError, match=r"TOMOSIM_HOST.*loopback"):
        check_address(make_settings(host=host), keys)
    check_address(make_settings(host=host, trusted_network=True), keys)
    check_address(make_settings(host=host, admin_key="a" * 32), keys)
    keys.create("one", ["read"])
    check_address(make_settings(host=host), keys)


def test_the_admin_key(make_settings, tmp_path, monkeypatch):
    with pytest.raises(SettingsError, match=r"TOMOSIM_ADMIN_KEY.*5 characters"):
        make_settings(admin_key="short")
    assert "aaaa" not in repr(make_settings(admin_key="a" * 40))
    path = tmp_path / "key"
    path.write_text("a" * 40 + "\n")
    monkeypatch.setenv("TOMOSIM_ADMIN_KEY_FILE", str(path))
    assert make_settings().admin_secret == "a" * 40
    path.write_text("short")
    with pytest.raises(SettingsError, match="TOMOSIM_ADMIN_KEY") as refused:
        make_settings()
    assert "short" not in str(refused.value)


@pytest.mark.parametrize(
    ("host", "expected"), [("127.0.0.1", True), ("::1", True), ("[::1]", True), ("localhost", True)]
)
def test_loopback(host, expected):
    assert is_loopback(host) is expected


def test_a_wrong_value_names_its_variable(make_settings, monkeypatch):
    monkeypatch.setenv("TOMOSIM_PORT", "many")
    with pytest.raises(SettingsError, match=r"TOMOSIM_PORT = 'many'"):
        make_settings()


def test_environment_round_trip(make_settings, monkeypatch):
    settings = make_settings(port=4711, lease_seconds=2.5, trusted_network=True, admin_key="a" * 40)
    for name, value in settings.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings.load() == settings


def test_long_data_folder_gets_a_short_socket(make_settings, tmp_path):
    settings = make_settings(data_folder=tmp_path / ("x" * 120))
    assert len(os.fsencode(settings.broker_socket)) <= MAX_SOCKET_PATH
    assert settings.broker_socket != make_settings(data_folder=tmp_path / ("y" * 120)).broker_socket


def test_service_parents_load_no_kernels(make_settings):
    """The Celery parent and the API stay light; the compute process loads the rest."""
    heavy = ("numba", "scipy", "pytetwild", "skimage")
    light = "api.app, worker.compute.app, worker.serve.embedded"
    code = f"import sys, {light}; print(*(m for m in {heavy} if m in sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment(make_settings()), capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == []


def test_every_setting_is_described():
    undescribed = [n for n, f in Settings.model_fields.items() if n != "log_level" and not f.description]
    assert undescribed == []


def test_data_folder_is_absolute(make_settings, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert make_settings(data_folder=Path("here")).data_folder == tmp_path / "here"


def test_secrets_lie_in_files(make_settings, monkeypatch, tmp_path):
    (tmp_path / "password").write_text("p@ss/word\n")
    monkeypatch.setenv("TOMOSIM_DATABASE_PASSWORD_FILE", str(tmp_path / "password"))
    settings = make_settings(database_url="postgresql://me@db/tomosim")
    assert settings.resolved_database_url == "postgresql://me:p%40ss%2Fword@db/tomosim"
    assert "p@ss" not in repr(settings)
    # A child has it in its environment, which wins over the file.
    (tmp_path / "password").unlink()
    for name, value in settings.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings.load().resolved_database_url == settings.resolved_database_url


def test_a_secret_without_its_file(make_settings, monkeypatch):
    monkeypatch.setenv("TOMOSIM_STORE_SECRET_KEY_FILE", "/nowhere/secret")
    with pytest.raises(SettingsError, match=r"TOMOSIM_STORE_SECRET_KEY_FILE = '/nowhere/secret'"):
        make_settings()


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"store_url": "/data/store"}, r"TOMOSIM_STORE_URL.*'/data/store'.*s3://bucket"),
        ({"store_url": "s3://B"}, "TOMOSIM_STORE_URL"),
        ({"store_access_key": "key"}, "TOMOSIM_STORE_SECRET_KEY"),
    ],
)
def test_a_wrong_store_is_refused(make_settings, wrong, said):
    with pytest.raises(SettingsError, match=said):
        make_settings(**wrong)
