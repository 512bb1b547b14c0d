"""``tomosim store check``: says what a store does not do, before cases find out."""

import subprocess
import sys

import pytest

from simcore.core.errors import StoreError
from simcore.store.bucket import Bucket
from worker.serve.processes import environment
from worker.upkeep.store_check import check


@pytest.fixture
def s3_settings(make_settings, make_location):
    place = make_location()
    keys = {"store_access_key": place.access_key, "store_secret_key": place.secret_key}
    return make_settings(store_url=place.url, store_endpoint=place.endpoint, **keys)


def test_a_bucket_that_can_be_used(s3_settings):
    assert "can be used" in check(s3_settings, make=False)


@pytest.mark.parametrize(("condition", "ignored"), [("If-None-Match", {"fresh": False}), ("If-Match", {"tag": None})])
def test_a_service_that_ignores_conditions_is_refused(s3_settings, monkeypatch, condition, ignored):
    put = Bucket.put
    tag = "fresh" if "fresh" in ignored else "tag"
    monkeypatch.setattr(
        Bucket,
        "put",
        lambda self, name, content, **conditions: put(
            self, name, content, **{**conditions, **({} if tag not in conditions else ignored)}
        ),
    )
    with pytest.raises(StoreError, match=condition):
        check(s3_settings, make=False)


def test_by_command(s3_settings, make_settings):
    def tomosim(settings, *words):
        command = [sys.executable, "-m", "tomosim", "store", "check", *words]
        return subprocess.run(command, env=environment(settings), capture_output=True, text=True)

    missing = s3_settings.model_copy(update={"store_url": "s3://made-by-command"})
    refused = tomosim(missing)
    assert refused.returncode == 4
    assert "bucket" in refused.stderr
    assert "can be used" in tomosim(missing, "--make").stdout
    assert "can be used" in tomosim(missing, "--make").stdout
    folder = make_settings(store_url="", store_access_key="", store_secret_key="")
    assert str(folder.store_folder) in tomosim(folder).stdout
