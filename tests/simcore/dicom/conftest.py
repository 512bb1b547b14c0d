"""Exports of the small case."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.support.dicom_case import SmallCase, make_case


@pytest.fixture(scope="session")
def small_case() -> SmallCase:
    return make_case()


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Callable[[SmallCase], Path]:
    """Export a case to a fresh folder."""

    def run(case: SmallCase) -> Path:
        folder = tmp_path_factory.mktemp("export")
        case.export(folder)
        return folder

    return run
