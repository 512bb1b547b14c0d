"""Objects that are written on request: one file and one line each."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from simcore.dicom.common import Instance
from simcore.dicom.objects import attenuation_map, ct, presentation, report, synthetic_2d
from simcore.dicom.study import Study

Files = Iterable[tuple[str, Callable[[], Instance]]]
"""Name of every file, and what makes its object when its turn comes."""

EXTRAS: dict[str, Callable[[Study], Files]] = {
    "presentation": presentation.files,
    "synthetic-2d": synthetic_2d.files,
    "ct": ct.files,
    "attenuation": attenuation_map.files,
    "report": report.files,
}
"""By their name in ``ExportSpec.extra_objects``."""
