"""How good the images are: texture, resolution, spread of artefacts, contrast, noise; and all of it for one case.

Pure functions of arrays; ``analyse`` reads the folder of a case. Methods and their sources: docs/quality.md.
"""

from __future__ import annotations

from simcore.quality.analysis import analyse
from simcore.quality.contrast import Contrast, disk_contrast
from simcore.quality.mtf import frequency_at, line_spread_mtf, slanted_edge_mtf
from simcore.quality.noise import noise_power
from simcore.quality.profiles import artefact_spread, cut_out, full_width_at_half_maximum, in_plane_profile
from simcore.quality.table import table
from simcore.quality.texture import power_law_exponent, texture

__all__ = [
    "Contrast",
    "analyse",
    "artefact_spread",
    "cut_out",
    "disk_contrast",
    "frequency_at",
    "full_width_at_half_maximum",
    "in_plane_profile",
    "line_spread_mtf",
    "noise_power",
    "power_law_exponent",
    "slanted_edge_mtf",
    "table",
    "texture",
]
