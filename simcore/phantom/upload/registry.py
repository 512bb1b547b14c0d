"""Uploaded phantoms in the store: the file as an object, and a note about it that outlives every collection.

objects/ab/<sha256>        the file
phantoms/<sha256>.json     the note; as long as it is there the object is in use
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from pydantic import ValidationError

from simcore.core.canonical import canonical
from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.phantom.upload import paddle, segments, tissue_maps, wall
from simcore.phantom.upload.anatomy import Anatomy
from simcore.phantom.upload.formats.decoding import read_header
from simcore.phantom.upload.formats.header import Edges, Header, reason, refuse
from simcore.phantom.upload.formats.joining import join, two_files
from simcore.phantom.upload.loading import survey
from simcore.phantom.upload.paddle import not_compressed, refused
from simcore.phantom.upload.reading import Reading
from simcore.phantom.upload.review import review
from simcore.phantom.upload.spec import UploadedPhantom
from simcore.store.hashing import FileRef
from simcore.store.store import Store

LEAST_ML, MOST_ML = 20.0, 5000.0
"""Volumes of breasts; others are more likely a matter of units."""
_OTHER_UNITS = {"cm": 10.0, "um": 1e-3}

FOLDER = "phantoms"
SCHEMA = "tomosim-phantom/1"


@dataclass(frozen=True)
class Upload:
    """A file in the store.

    name: what it was called. values: voxels of every value {value: count}.
    phantom: the part of a specification that uses it. remarks: what was not read as it stands in the file, what is
    odd about it, and what of it is left out. contents: tissue and volume of every value, ``review.Review.contents``.
    ends: voxels of tissue in the first, largest and last plane across each axis of the array.
    plates_mm: distance of the plates that are in the file.
    """

    sha256: str
    size: int
    name: str
    format: str
    values: dict[str, int]
    phantom: dict[str, Any]
    remarks: tuple[str, ...] = ()
    contents: tuple[dict[str, Any], ...] = ()
    ends: tuple[tuple[int, int, int], ...] = ()
    plates_mm: float | None = None
    schema: str = field(default=SCHEMA)

    @property
    def ref(self) -> FileRef:
        return FileRef(self.sha256, self.size)

    @property
    def spec(self) -> UploadedPhantom:
        """raises: pydantic.ValidationError where the note was changed by hand"""
        return UploadedPhantom.model_validate_json(json.dumps(self.phantom))


def add_file(store: Store, path: Path, reading: Reading | None = None) -> Upload:
    """Copies a file of any format into the store, a header and the voxels beside it (.mhd, .nhdr) as one.

    raises: SpecError where it cannot be read or holds values without a tissue.
    """
    reading = reading or Reading()
    try:
        path.open("rb").close()
    except OSError as error:
        raise SpecError(f"{path} cannot be read: {error.strerror}", code="upload-not-readable") from error
    voxels, header = (two_files(path) if reading.raw is None else None) or (path, None)
    with store.workspace() as folder:
        target = folder / "upload"
        if header is None:
            shutil.copyfile(voxels, target)
            return add_received(store, target, path.name, reading)
        with open(voxels, "rb") as source, open(target, "wb") as file:
            join(header, source, file)
        with open(path, "rb") as file:
            named = segments.names(file)
        return _add(store, target, path.name, reading, header, named)


def add_received(store: Store, received: Path, name: str, reading: Reading) -> Upload:
    """As ``add_file`` for one file in a workspace of the store, which is moved, not copied."""
    if reading.raw is None:
        return _add(store, received, name, reading, None)
    joined = received.with_name("joined")
    with open(received, "rb") as source, open(joined, "wb") as target:
        header = reading.raw.header(source)
        join(header, source, target)
    return _add(store, joined, name, reading, header)


def is_digest(text: str) -> bool:
    """Whether a text can be a digest; nothing else is made a part of a path."""
    return re.fullmatch("[0-9a-f]{64}", text) is not None


def get(store: Store, sha256: str) -> Upload | None:
    """The note of an upload, or None where there is none or its file is gone."""
    try:
        note = json.loads(store.read_document(FOLDER, f"{sha256}.json") or b"{}")
        lists = {name: tuple(note.get(name, ())) for name in ("remarks", "contents")}
        upload = Upload(**note | lists | {"ends": tuple(tuple(e) for e in note.get("ends", ()))})
    except (ValueError, TypeError):
        return None
    return upload if store.has(upload.ref) else None


def uploads(store: Store) -> list[Upload]:
    """All uploads, by digest."""
    notes = (get(store, name.removesuffix(".json")) for name in store.documents(FOLDER))
    return [upload for upload in notes if upload is not None]


def open_file(store: Store, spec: UploadedPhantom) -> IO[bytes]:
    """The file of ``spec``. raises: SpecError where it was never added"""
    upload = require(store, spec)
    return open(store.path(upload.ref), "rb")


def require(store: Store, spec: UploadedPhantom) -> Upload:
    """The note of the file of ``spec``. raises: SpecError where it was never added, or has another shape"""
    upload = get(store, spec.sha256)
    if upload is None:
        message = "there is no such file here: add it with 'tomosim phantom add' or POST /v1/phantoms"
        raise SpecError(
            f"phantom.sha256 = {spec.sha256}: {message}",
            code="upload-not-found",
            problems=[{"field": "phantom.sha256", "value": spec.sha256, "message": message}],
        )
    if tuple(upload.phantom["shape"]) != spec.shape:
        raise refused("shape", list(spec.shape), f"the file has {upload.phantom['shape']} voxels")
    _check_against(upload, spec)
    return upload


def _check_against(upload: Upload, spec: UploadedPhantom) -> None:
    """raises: SpecError where ``spec`` says of a file what is known to be otherwise since it was added"""
    noted = upload.spec
    if spec.tissues != noted.tissues:
        _check_values(upload, spec)  # no more is known of its tissue then
        return
    if upload.plates_mm is not None:
        if not spec.compressed:
            raise not_compressed()
        if spec.axes == noted.axes and spec.spacing_mm == noted.spacing_mm and spec.thickness_mm is not None:
            paddle.check_thickness(spec.thickness_mm, upload.plates_mm, spec.edge_mm("z"))
    planes = zip(noted.planes_used(), spec.planes_used(), strict=True)
    less = spec.compressed == noted.compressed and any(real > said + 0.5 for real, said in planes)
    if less and noted.extent_mm and spec.extent_mm:
        size = " x ".join(f"{side:g}" for side in noted.extent_mm)
        message = f"the tissue is {size} mm with voxels of {list(noted.spacing_mm)} mm; that, or none (null)"
        raise refused("extent_mm", list(spec.extent_mm), message)
    if len(upload.ends) == 3 and spec.axes != noted.axes:
        a, b, c = (wall.Ends(*e) for e in upload.ends)
        wall.check((a, b, c), spec.axes)


def _check_values(upload: Upload, spec: UploadedPhantom) -> None:
    """raises: SpecError where the tissues of ``spec`` do not fit the values of a file"""
    table = tissue_maps.table(spec.tissues)
    codes = {value: int(table[int(value)]) for value in upload.values}
    unknown = [int(value) for value, code in codes.items() if code == tissue_maps.UNKNOWN]
    if unknown:
        tissue_maps.refuse_unknown(unknown)
    if not set(codes.values()) - {Tissue.AIR, tissue_maps.PADDLE}:
        raise refused("tissues", None, "the label volume holds nothing but air")
    if tissue_maps.PADDLE in codes.values() and not spec.compressed:
        raise not_compressed()


def _add(
    store: Store,
    path: Path,
    name: str,
    reading: Reading,
    original: Header | None,
    named: dict[int, str] | None = None,
) -> Upload:
    """original: a header that is not in the file any more; named: segments in it."""
    with open(path, "rb") as file:
        header = original or read_header(file)
        spacing, axes = header.placed(reading.spacing_mm, reading.axes)
        tissues, said = _tissues(reading, named or segments.names(file))
        anatomy = Anatomy(header.shape)
        scan = survey(file, tissues, anatomy=anatomy)
    if scan.box is None:
        raise refuse(f"it holds nothing but air by the tissue map: values {', '.join(map(str, scan.values))}")
    judgement = review(scan, anatomy, spacing, axes, tissues, reading.compressed, reading.confirm_tissues)
    _check_volume(scan.body_voxels, spacing, reading)  # last: what is no breast in any unit is told as that
    try:
        phantom = UploadedPhantom(
            sha256=64 * "0",
            shape=header.shape,
            spacing_mm=spacing,
            axes=axes,
            tissues=tissues,
            compressed=reading.compressed,
            thickness_mm=judgement.thickness_mm,
            extent_mm=judgement.extent_mm,
        )
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise refuse(f"{'.'.join(map(str, first['loc']))} = {first['input']}: {first['msg']}") from None
    ref = store.add(path)
    values = {str(value): count for value, count in scan.values.items()}
    part = phantom.with_(sha256=ref.sha256).model_dump(mode="json")
    remarks = (*header.remarks, *_overridden(header, reading), *said, *judgement.remarks)
    upload = Upload(
        ref.sha256,
        ref.size,
        name,
        scan.header.format,
        values,
        part,
        remarks,
        judgement.contents,
        tuple((e.first, e.largest, e.last) for e in scan.ends(scan.box)),
        judgement.thickness_mm,
    )
    store.write_document(FOLDER, f"{upload.sha256}.json", canonical(asdict(upload)))
    return upload


def _tissues(reading: Reading, named: dict[int, str]) -> tuple[tissue_maps.TissueMap, tuple[str, ...]]:
    """The tissue map of a file, and how it came about where nobody said."""
    if reading.tissues is not None:
        return reading.tissues, ()
    if not named:
        return "victre", ()
    tissues = segments.tissue_map(named)
    listed = ", ".join(f"{value} {name!r} = {tissues[str(value)]}" for value, name in sorted(named.items()))
    return tissues, (f"tissues are taken from the names of the segments: {listed}",)


def _overridden(header: Header, reading: Reading) -> Iterator[str]:
    """What was said of the file and replaces what it says itself."""
    if reading.axes is not None and reading.axes != header.axes:
        known = ",".join(header.axes or ())
        yield f"axes: {','.join(reading.axes)} as given, {_instead(header, 'axes', known)}"
    if reading.spacing_mm is not None and reading.spacing_mm != header.spacing_mm:
        known = " x ".join(f"{e:g}" for e in header.spacing_mm or ())
        edges = " x ".join(f"{e:g}" for e in reading.spacing_mm)
        yield f"voxels of {edges} mm as given, {_instead(header, 'spacing_mm', known)}"


def _instead(header: Header, name: str, known: str) -> str:
    problem = header.problems.get(name)
    if problem is not None:
        return f"not as in the file ({reason(problem)})"
    return f"not {known} as in the file" if known else "as the file does not say"


def _check_volume(voxels: int, spacing_mm: Edges, reading: Reading) -> None:
    """raises: SpecError for a breast of a size that speaks of a wrong unit, unless it is confirmed"""
    a, b, c = spacing_mm
    ml = voxels * a * b * c * 1e-3
    if reading.confirm_size or LEAST_ML <= ml <= MOST_ML:
        return
    edges = " x ".join(f"{e:g}" for e in spacing_mm)
    units = " and ".join(f"{_litres(ml * scale**3)} in {unit}" for unit, scale in _OTHER_UNITS.items())
    message = (
        f"the tissue is {_litres(ml)} ({voxels} voxels of {edges} mm); a breast has from {_litres(LEAST_ML)} to "
        f"{_litres(MOST_ML)}. "
        f"The same numbers would make {units}: say the right ones in mm (--spacing-mm A,B,C, spacing_mm), or confirm "
        "the size (--confirm-size, confirm_size = true)"
    )
    raise SpecError(
        f"the label volume has an unlikely size: {message}",
        code="upload-unlikely-size",
        problems=[{"field": "spacing_mm", "value": list(spacing_mm), "message": message}],
    )


def _litres(ml: float) -> str:
    if ml >= 1000:
        return f"{ml / 1000:,.4g} l"
    return f"{ml:.3g} ml" if ml >= 0.001 else "less than 0.001 ml"
