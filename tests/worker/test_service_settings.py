"""Settings: defaults that work, refusals that name the variable."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from worker.processes import environment
from worker.settings import MAX_SOCKET_PATH, Settings, SettingsError, is_loopback


def test_defaults_need_nothing(make_settings):
    settings = make_settings()
    assert settings.host == "127.0.0.1"
    assert settings.resolved_database_url == f"sqlite:///{settings.data_folder}/tomosim.db"
    assert settings.resolved_broker_url == f"redis+socket://{settings.broker_folder}/socket?virtual_host=0"
    assert settings.threads >= 1
    assert settings.visibility_timeout > settings.job_timeout_seconds


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "::", "example.org"])
def test_only_loopback_without_keys(make_settings, host):
    with pytest.raises(SettingsError, match=r"TOMOSIM_HOST.*loopback"):
        make_settings(host=host)
    assert make_settings(host=host, trusted_network=True).host == host


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
    settings = make_settings(port=4711, lease_seconds=2.5, trusted_network=True)
    for name, value in settings.environment().items():
        monkeypatch.setenv(name, value)
    assert Settings.load() == settings


def test_long_data_folder_gets_a_short_socket(make_settings, tmp_path):
    settings = make_settings(data_folder=tmp_path / ("x" * 120))
    assert len(os.fsencode(settings.broker_socket)) <= MAX_SOCKET_PATH
    assert settings.broker_socket != make_settings(data_folder=tmp_path / ("y" * 120)).broker_socket


def test_service_parents_load_no_kernels(make_settings):
    """The Celery parent and the API stay light; the compute process loads the rest."""
    heavy = ("numba", "scipy", "pytetwild", "skimage", "simcore.pipeline")
    code = f"import sys, api.app, worker.app, worker.embedded; print(*(m for m in {heavy} if m in sys.modules))"
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
