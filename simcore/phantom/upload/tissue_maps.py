"""Which tissue a value of an uploaded label volume is."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

from pydantic import AfterValidator

from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue

if TYPE_CHECKING:  # specifications name tissues where nothing may load numerics
    import numpy as np
    from numpy.typing import NDArray

LARGEST_VALUE = 65535
UNKNOWN = 255
"""What stands in a table for a value that is no tissue."""
PADDLE = 254
"""What stands in a table for the plates of a compression, which are no tissue: their planes are read."""

VICTRE = {
    0: Tissue.AIR,
    1: Tissue.ADIPOSE,
    2: Tissue.SKIN,
    29: Tissue.GLAND,
    33: Tissue.NIPPLE,
    40: Tissue.MUSCLE,
    50: PADDLE,
    88: Tissue.LIGAMENT,
    95: Tissue.TDLU,
    125: Tissue.DUCT,
    150: Tissue.ARTERY,
    200: Tissue.MASS,
    225: Tissue.VEIN,
    250: Tissue.CALCIFICATION,
}
"""Labels of the VICTRE phantoms. 50 are the compression plates."""

OPENVCT = {
    0: Tissue.AIR,
    1: Tissue.LIGAMENT,
    2: Tissue.SKIN,
    3: Tissue.ADIPOSE,
    4: Tissue.GLAND,
    5: Tissue.CALCIFICATION,
}
"""Indices of OpenVCT's generator (bbarufaldi/OpenVCT_Pipeline: split_criterion_distr_thickness.cl has 3 as fat, 4 as
gland, 1 between compartments; anatomy/vct_config.xml has the materials). Its mixtures, 6 and above, differ from study
to study: they are left to a map of one's own."""

BUILT_IN: dict[str, dict[int, int]] = {
    "victre": {value: int(tissue) for value, tissue in VICTRE.items()},
    "tomosim": {int(t): int(t) for t in Tissue},
    "openvct": {value: int(tissue) for value, tissue in OPENVCT.items()},
}
TISSUES = {t.name.lower(): int(t) for t in Tissue}
NAMES = (*TISSUES, "paddle")


def _checked(tissues: str | dict[str, str]) -> str | dict[str, str]:
    if isinstance(tissues, str):
        if tissues not in BUILT_IN:
            raise ValueError(f"{tissues!r} is no known table: {', '.join(BUILT_IN)}, or an object {{value: tissue}}")
        return tissues
    if not tissues:
        raise ValueError("no value has a tissue")
    for value, name in tissues.items():
        if not (value.isascii() and value.isdigit() and int(value) <= LARGEST_VALUE):
            raise ValueError(f"{value!r} is no value of a voxel: whole numbers from 0 to {LARGEST_VALUE}")
        if name not in NAMES:
            raise ValueError(f"{name!r} (value {value}) is no tissue; there are: {', '.join(NAMES)}")
    return tissues


TissueMap = Annotated[str | dict[str, str], AfterValidator(_checked)]
"""The name of a built-in map, or {value: tissue}."""


def _codes(tissues: TissueMap) -> dict[int, int]:
    """The tissue, or PADDLE, of every value that a map names."""
    codes = {**TISSUES, "paddle": PADDLE}
    return BUILT_IN[tissues] if isinstance(tissues, str) else {int(v): codes[n] for v, n in tissues.items()}


def table(tissues: TissueMap) -> NDArray[np.uint8]:
    """uint8 (LARGEST_VALUE + 1,): the tissue of every value, UNKNOWN where there is none."""
    import numpy as np

    result = np.full(LARGEST_VALUE + 1, UNKNOWN, np.uint8)
    for value, tissue in _codes(tissues).items():
        result[value] = tissue
    return result


def has_tissue(tissues: TissueMap, tissue: Tissue) -> bool:
    """Whether any value is a tissue."""
    return tissue in _codes(tissues).values()


def name_of(code: int) -> str:
    """What an entry of a table is called."""
    return "paddle" if code == PADDLE else Tissue(code).name.lower()


def refuse_unknown(values: Iterable[int]) -> None:
    """raises: SpecError naming ``values`` that are no tissue"""
    listed = sorted(values)
    shown = ", ".join(map(str, listed[:20])) + (", ..." if len(listed) > 20 else "")
    raise _unknown(
        listed[0],
        f"the tissue map names no tissue for {shown}; tissues: {', '.join(NAMES)}; built-in maps: "
        f"{', '.join(BUILT_IN)} (--tissue-map, tissues)",
    )


def refuse_beyond(value: float, type_name: str) -> None:
    """raises: SpecError naming a ``value`` below 0 or above LARGEST_VALUE, which no map can name"""
    origin = ""
    if -128 <= value < 0 and type_name == "int8":
        origin = f" (saved as int8, {value + 256:.0f} becomes {value:.0f})"
    raise _unknown(
        int(value) if abs(value) < 2**63 else value,
        f"the tissue map names no tissue for {value:.15g}, and none can{origin}: labels are whole numbers from 0 to "
        f"{LARGEST_VALUE}; give those voxels such a value, and save the labels as uint8 or uint16",
    )


def _unknown(value: float, message: str) -> SpecError:
    return SpecError(
        f"phantom.tissues: {message}",
        code="unknown-label",
        problems=[{"field": "phantom.tissues", "value": value, "message": message}],
    )
