"""A test whose Debian package is missing is skipped, and fails with ``--require-services``: both say which it is."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
MARKED = "tests/simcore/dicom/test_dicom_dcmtk.py::test_encoded_frames_are_decoded_to_the_same_pixels"
"""needs_dcmtk"""
UNMARKED = "tests/api/test_api_quotas.py"
"""Runs on PostgreSQL with ``--production``."""


def outcome(folder: Path, *arguments: str) -> tuple[int, str]:
    """Exit code and output of pytest where no Debian package is installed: it would be on the path."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *arguments]
    environment = {**os.environ, "PATH": str(folder), "PYTHONPATH": str(ROOT)}
    ended = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    return ended.returncode, ended.stdout


def test_skipped(tmp_path: Path):
    code, said = outcome(tmp_path, MARKED)
    assert code == 0, said
    assert "1 passed" not in said
    assert "dcmdrle is not installed: needs the Debian package dcmtk" in said


def test_failed(tmp_path: Path):
    code, said = outcome(tmp_path, "--require-services", MARKED)
    assert code == 1, said
    assert "1 failed" in said or "1 error" in said
    assert "dcmdrle is not installed: needs the Debian package dcmtk" in said


def test_a_service_that_production_needs(tmp_path: Path):
    code, said = outcome(tmp_path, "--production", "--require-services", UNMARKED)
    assert code == 1, said
    assert "needs the Debian package" in said
