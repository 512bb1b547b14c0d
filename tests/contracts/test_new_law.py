"""A new constitutive law is one file and its name in the union."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
YEOH = '''
"""Yeoh's law of two terms."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

from simcore.core.spec_base import Spec, quantity
from simcore.fem.laws.law import Energy, InvariantEnergy, Law, bulk_modulus


def derivatives(c: Any, a: float, b: float) -> tuple[float, float, float, float, float]:
    return c[0] + 2.0 * c[1] * a, 0.0, 2.0 * c[1], 0.0, 0.0


ENERGY = InvariantEnergy("yeoh", derivatives, stresses=(0, 1), stiffens=True)


class Yeoh(Spec):
    energies: ClassVar[tuple[Energy, ...]] = (ENERGY,)

    kind: Literal["yeoh"] = "yeoh"
    c10_kPa: float = quantity("coefficient of I1 - 3", unit="kPa", gt=0.0, le=1000.0)
    c20_kPa: float = quantity("coefficient of (I1 - 3)^2", unit="kPa", ge=0.0, le=1000.0)

    def law(self) -> Law:
        shear = 2 * self.c10_kPa
        return Law(ENERGY, (self.c10_kPa, self.c20_kPa), shear, bulk_modulus(shear, 0.49))
'''
USE = """
import json, numpy as np
from simcore.fem.laws.energies import COEFFICIENTS, add_energy_derivatives, number_of
from simcore.fem.spec import CompressionSpec
law = CompressionSpec.model_validate({"material": {"kind": "yeoh", "c10_kPa": 3.0, "c20_kPa": 5.0}}).material.law()
c = np.zeros(COEFFICIENTS)
c[:2] = law.coefficients
first, second = np.zeros(3), np.zeros((3, 3))
squared = np.array([0.64, 1.25, 1.25])  # J = 1
add_energy_derivatives(number_of(law.energy), c, 1.0, squared, np.sqrt(np.prod(squared)), first, second)
print(json.dumps(first.tolist()))
"""


def test_a_law_is_one_file_and_its_name_in_the_union(tmp_path: Path):
    shutil.copytree(ROOT / "simcore", tmp_path / "simcore", ignore=shutil.ignore_patterns("__pycache__"))
    laws = tmp_path / "simcore" / "fem" / "laws"
    (laws / "yeoh.py").write_text(YEOH)
    union = (laws / "plain.py").read_text()
    named = union.replace("OneLaw = NeoHookean |", "OneLaw = Yeoh | NeoHookean |")
    assert named != union
    (laws / "plain.py").write_text(named.replace("\nOneLaw", "\nfrom simcore.fem.laws.yeoh import Yeoh\n\nOneLaw"))
    done = subprocess.run(
        [sys.executable, "-c", USE], cwd=tmp_path, env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    a = 0.64 + 1.25 + 1.25 - 3
    slope = 3.0 + 2 * 5.0 * a  # tau_i = 2 W' (b_i - I1 / 3)
    assert json.loads(done.stdout) == pytest.approx([2 * slope * (b - (a + 3) / 3) for b in (0.64, 1.25, 1.25)])
