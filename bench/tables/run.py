"""Makes the tables of simcore/physics/data again from the packages that they come from.

    python -m bench.tables [cross_sections] [form_factors] [fluorescence] [anodes]

Needs spekpy 2.5, xraydb 4.5 and xraylib 4.3, which nothing else needs (simcore/physics/data/SOURCES.md).
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tables.anodes import anode_tables

FOLDER = Path(__file__).parents[2] / "simcore" / "physics" / "data"
LIGHT = "H Be B C N O F Na Mg Al Si P S Cl Ar K Ca"
HEAVY = "Ti Cr Mn Fe Ni Cu Zn Se Br Sr Mo Rh Ag Cd Sn I Cs Ba Gd W Au Pb Bi"
ELEMENTS = f"{LIGHT} {HEAVY}".split()
LOWEST_KEV, HIGHEST_KEV, GRID_POINTS = 1.0, 150.0, 140
LARGEST_X, X_POINTS = 12.2, 160
STEP_WITHIN_EV = 6.0


def cross_sections(path: Path) -> None:
    """Photo-absorption, coherent and incoherent scattering of the elements, cm2/g, both sides of every edge."""
    import xraydb

    grid = np.geomspace(LOWEST_KEV, HIGHEST_KEV, GRID_POINTS)
    energies, rows, starts, masses = [], [], [0], []
    for element in ELEMENTS:
        edges = sorted(edge.energy * 1e-3 for edge in xraydb.xray_edges(element).values())
        edges = [edge for edge in edges if LOWEST_KEV + 0.01 < edge < HIGHEST_KEV - 0.01]
        apart = grid[[all(abs(energy - edge) > 3e-3 for edge in edges) for energy in grid]]
        sampled = np.concatenate([apart, *(_beside_the_step(element, edge) for edge in edges)])
        named = np.concatenate([apart, *([edge, edge] for edge in edges)])
        order = np.argsort(sampled)
        rows.append(
            np.array([xraydb.mu_elam(element, sampled[order] * 1e3, kind=k) for k in ("photo", "coh", "incoh")])
        )
        energies.append(named[order])
        starts.append(starts[-1] + len(named))
        masses.append(xraydb.atomic_mass(element))
    np.savez_compressed(
        path,
        elements=np.array(ELEMENTS),
        atomic_mass=np.array(masses),
        starts=np.array(starts),
        energies_keV=np.concatenate(energies),
        cm2_per_g=np.concatenate(rows, axis=1).astype(np.float32),
    )


def _beside_the_step(element: str, edge_keV: float) -> NDArray[np.float64]:
    """Energies in keV just below and above the step, which stands a few eV beside the nominal edge in the source."""
    import xraydb

    energies = edge_keV + 1e-3 * np.arange(-STEP_WITHIN_EV, STEP_WITHIN_EV + 0.25, 0.5)
    rises = np.diff(np.log(xraydb.mu_elam(element, energies * 1e3, kind="photo")))
    step = int(np.argmax(rises))
    return energies[step : step + 2]


def form_factors(path: Path) -> None:
    """Atomic form factors and incoherent scattering functions over x = sin(theta / 2) / wavelength, 1/Angstrom."""
    import xraylib

    x = np.concatenate([[0.0], np.geomspace(2e-3, LARGEST_X, X_POINTS - 1)])
    numbers = [xraylib.SymbolToAtomicNumber(element) for element in ELEMENTS]
    form = np.array([[xraylib.FF_Rayl(number, float(value)) for value in x] for number in numbers])
    scattering = np.array([[xraylib.SF_Compt(number, float(v)) if v > 0 else 0.0 for v in x] for number in numbers])
    np.savez_compressed(
        path,
        elements=np.array(ELEMENTS),
        x_per_angstrom=x,
        form_factor=form.astype(np.float32),
        scattering_function=scattering.astype(np.float32),
    )


def fluorescence(path: Path) -> None:
    """K shells with an edge in the table: edge, share of the photo-absorption, yield, lines."""
    import xraydb

    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["element", "edge_keV", "k_share", "yield", "k_alpha_keV", "k_beta_keV", "k_alpha_share"])
        for element in ELEMENTS:
            shell = xraydb.xray_edges(element)["K"]
            if shell.energy < 1e3 * LOWEST_KEV:
                continue
            lines = xraydb.xray_lines(element, initial_level="K")
            alpha, alpha_weight = _mean_line(lines, "Ka")
            beta, beta_weight = _mean_line(lines, "Kb")
            numbers = (
                shell.energy * 1e-3,
                1 - 1 / shell.jump_ratio,
                shell.fyield,
                alpha,
                beta or alpha,
                alpha_weight / (alpha_weight + beta_weight),
            )
            table.writerow([element, *(f"{number:.4f}" for number in numbers)])


def _mean_line(lines: dict[str, Any], start: str) -> tuple[float, float]:
    """Mean energy in keV and intensity of a group of lines; 0 and 0 where there is none."""
    group = [line for name, line in lines.items() if name.startswith(start) and line.intensity > 0]
    weight = sum(line.intensity for line in group)
    return (sum(line.energy * line.intensity for line in group) / weight * 1e-3 if weight else 0.0), weight


MAKERS = {
    "cross_sections": ("cross_sections.npz", cross_sections),
    "form_factors": ("form_factors.npz", form_factors),
    "fluorescence": ("fluorescence.csv", fluorescence),
    "anodes": ("anodes.npz", anode_tables),
}


def main() -> None:
    """Makes the tables that are named, all where none is."""
    for name in sys.argv[1:] or MAKERS:
        file, maker = MAKERS[name]
        maker(FOLDER / file)
        print(f"{file}: {(FOLDER / file).stat().st_size} bytes")
