"""Specifications, presets and estimates can be used without loading a kernel (the API and the Celery parent do)."""

import subprocess
import sys

import pytest

HEAVY = ("numba", "pytetwild", "skimage", "llvmlite")


@pytest.mark.parametrize(
    "module",
    ["simcore.spec", "simcore.presets", "simcore.estimate", "simcore.pipeline", "simcore.store.store", "tomosim.cli"],
)
def test_no_heavy_import(module: str):
    code = f"import sys, {module}; print(*(m for m in {HEAVY!r} if m in sys.modules))"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert modules == []
