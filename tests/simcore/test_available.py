"""What a library is missing for is refused early, by the field that asks for it."""

import importlib.util
from pathlib import Path

import pytest

from simcore import estimate, pipeline, presets
from simcore.core.errors import SpecError
from simcore.pipeline import result
from simcore.store.store import Store

ASKS = {
    "jpeg_ls": ({"mesh": {"kind": "lattice"}, "export": {"encoding": "jpeg-ls"}}, "export.encoding", "'rle' or 'none'"),
    "pytetwild": ({"mesh": {"kind": "tetwild"}}, "mesh.kind", "'lattice'"),
}


@pytest.mark.parametrize("missing", ASKS)
def test_a_library_that_is_not_installed(missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    changes, field, remedy = ASKS[missing]
    tiny = presets.get("tiny").model_dump(mode="json")
    spec = type(presets.get("tiny")).from_dict({**tiny, **changes})
    estimate.check(spec)
    known = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name, *a: None if name == missing else known(name, *a))
    for refused in (lambda: estimate.check(spec), lambda: pipeline.run(spec, Store(tmp_path))):
        with pytest.raises(SpecError) as no:
            refused()
        assert no.value.code == "library-missing"
        assert [p["field"] for p in no.value.problems] == [field]
        assert remedy in str(no.value)
        assert field in str(no.value)


def test_the_manifest_leaves_out_what_is_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "pytetwild" in result._libraries()
    monkeypatch.setattr(result, "LIBRARIES", ("numpy", "no-such-library"))
    assert list(result._libraries()) == ["numpy"]


def test_nothing_is_refused_that_does_not_need_it(monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = presets.get("tiny").model_dump(mode="json")
    spec = type(presets.get("tiny")).from_dict({**tiny, "mesh": {"kind": "lattice"}})
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: None)
    estimate.check(spec)
