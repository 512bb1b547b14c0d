"""A store that was laid out before, byte by byte: in a folder and in a bucket."""

import hashlib
import json
import time
from functools import partial
from pathlib import Path

import pytest

from simcore.store.bucket import Bucket
from simcore.store.bucket_backend import BucketBackend
from simcore.store.hashing import FileRef
from simcore.store.store import Store

CONTENT = b"labels"
SHA256 = "d772ebb4590212c65cc31888ee55c3a893d866d8479f84a4c0ca36918a3fa75f"
KEY = "f33ec0b70f22b33db7e6f8dc8a0f330ece5913f09103c148b681bfedc51ab590"
OBJECT = f"objects/{SHA256[:2]}/{SHA256}"
RECORD = f"stages/{KEY[:2]}/{KEY}.json"
PLAIN = (
    f'{{"key":"{KEY}","outputs":{{"sub/a.txt":{{"sha256":"{SHA256}","size":6}}}},"peak_memory_bytes":1000,'
    '"report":{"n":1},"seconds":0.5,"stage":"phantom","version":3}'
)
PARAMETERS = ("phantom", 3, {"p": 1}, {"input": "d"})


@pytest.fixture(params=["folder", "bucket"])
def laid_out(request, tmp_path):
    """A store in which everything was written by hand, and what reads a name there."""
    files = {OBJECT: CONTENT, "phantoms/a.json": b"{}"}
    if request.param == "folder":
        for name, content in {**files, RECORD: PLAIN.encode()}.items():
            (tmp_path / name).parent.mkdir(parents=True)
            (tmp_path / name).write_bytes(content)
        return Store(tmp_path, 0), lambda name: (tmp_path / name).read_bytes()
    location = request.getfixturevalue("make_location")()
    bucket = Bucket(location)
    for name, content in {**files, RECORD: f'{{"record":{PLAIN},"written":"0123"}}'.encode()}.items():
        bucket.put(name, content)
    return Store(tmp_path, 0, partial(BucketBackend, location=location)), lambda name: bucket.get(name)[0]


def test_it_is_read(laid_out):
    store, _ = laid_out
    record, cached = store.run(*PARAMETERS, lambda *_: pytest.fail("computed again"))
    ref = record.outputs["sub/a.txt"]
    assert cached
    assert (record.stage, record.version, record.key, record.report) == ("phantom", 3, KEY, {"n": 1})
    assert (record.seconds, record.peak_memory_bytes) == (0.5, 1000)
    assert store.path(ref).read_bytes() == b"".join(store.stream(ref)) == CONTENT
    assert (store.documents("phantoms"), store.read_document("phantoms", "a.json")) == (["a.json"], b"{}")
    assert [(r.name, o.name, o.size) for r, o in zip(store.records(), store.objects(), strict=True)] == [
        (KEY, SHA256, 6)
    ]


def test_it_is_written_so(laid_out):
    store, read = laid_out
    in_future = time.time() + 3600
    assert store.remove_record(KEY, in_future)
    assert store.remove_object(SHA256, in_future)

    def compute(folder: Path, key: str, hashing: object):
        (folder / "sub").mkdir()
        (folder / "sub" / "a.txt").write_bytes(CONTENT)
        return {"n": 1}, 0.5, 1000

    store.run(*PARAMETERS, compute)
    assert read(OBJECT) == CONTENT
    record = read(RECORD)
    if isinstance(store.backend, BucketBackend):
        stamp = json.loads(record)["written"]
        assert len(stamp) == 32
        assert record.decode() == f'{{"record":{PLAIN},"written":"{stamp}"}}'
    else:
        assert record.decode() == PLAIN
    assert FileRef(hashlib.sha256(CONTENT).hexdigest(), 6) == FileRef(SHA256, 6)
