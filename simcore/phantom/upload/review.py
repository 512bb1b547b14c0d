"""What a file holds as tissues, told before anything runs; and whether it can be a breast."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from simcore.core.errors import SpecError
from simcore.core.tissues import Tissue
from simcore.phantom.upload import lesions, pieces, tissue_maps, wall
from simcore.phantom.upload.anatomy import COVER, Anatomy
from simcore.phantom.upload.formats.header import Edges
from simcore.phantom.upload.loading import DENSE, Survey, cut_box
from simcore.phantom.upload.paddle import refused
from simcore.phantom.upload.spec import Axes

LEAST_PLANES = 4
"""Voxels that a breast needs along every axis: the outline of fewer vanishes where it is smoothed for the mesh."""
COVERED = 0.1
"""Where there is skin, at least this part of the surface is skin, or at least ..."""
OUTSIDE = 0.02
"""... this part of the skin is surface: one in thirty of a skin of 1.5 mm in voxels of 0.05 mm."""
MOST = {Tissue.SKIN: 0.5, Tissue.MUSCLE: 0.6, Tissue.MASS: 0.3, Tissue.CALCIFICATION: 0.05}
"""Parts of the tissue above which one is odd."""


@dataclass(frozen=True)
class Review:
    """contents: one entry a value, {value, tissue, voxels, ml, share}; share is that of all tissue, None beside it.
    remarks: what is odd, cut or dropped, in words. extent_mm: of what is used, along (x, y, z).
    thickness_mm: of the plates in the file; None where there are none.
    """

    contents: tuple[dict[str, Any], ...]
    remarks: tuple[str, ...]
    extent_mm: tuple[float, float, float]
    thickness_mm: float | None


def review(
    scan: Survey,
    anatomy: Anatomy,
    spacing_mm: Edges,
    axes: Axes,
    tissues: tissue_maps.TissueMap,
    compressed: bool,
    confirmed: bool,
) -> Review:
    """confirmed: whether the tissues are right, however odd.

    raises: SpecError where no breast can come of it
    """
    voxel_mm3 = float(np.prod(spacing_mm))
    contents = tuple(_contents(scan, tissues, voxel_mm3))
    volumes = _volumes(contents)
    remarks = list(_doubts(contents, volumes, anatomy, confirmed))
    extents = anatomy.body.extents()
    body = None if compressed else pieces.body_box(extents, voxel_mm3)
    if body is not None:
        ml = (extents.voxels.sum() - extents.voxels.max()) * voxel_mm3 * 1e-3
        count = len(extents) - 1
        what = "1 piece" if count == 1 else f"{count} pieces"
        remarks.append(f"left out: {what} beside the breast, {ml:.3g} ml in all")
    box, gap = cut_box(scan, axes, compressed, body)
    wall.check(scan.ends(box), axes)
    names = [axis[1] for axis in axes]
    planes = dict(zip(names, (last - first for first, last in box), strict=True))
    edges = dict(zip(names, spacing_mm, strict=True))
    if not compressed:
        _check_planes(planes)
    x, y, z = (round(planes[name] * edges[name], 6) for name in "xyz")
    if gap is not None:
        remarks += _plates(scan, gap.first, gap.behind, gap.single, gap.stray, z, names.index("z"), voxel_mm3)
    known = lesions.kinds(anatomy.lesions.extents(), np.array(spacing_mm))
    remarks += [f"lesions: {known}"] if str(known) else []
    return Review(contents, tuple(remarks), (x, y, z), None if gap is None else z)


def _contents(scan: Survey, tissues: tissue_maps.TissueMap, voxel_mm3: float) -> Iterator[dict[str, Any]]:
    table = tissue_maps.table(tissues)
    for value, voxels in scan.values.items():
        name = tissue_maps.name_of(int(table[value]))
        yield {
            "value": value,
            "tissue": name,
            "voxels": voxels,
            "ml": round(voxels * voxel_mm3 * 1e-3, 6),
            "share": None if name in ("air", "paddle") else round(voxels / max(1, scan.body_voxels), 6),
        }


def _volumes(contents: tuple[dict[str, Any], ...]) -> dict[Tissue, float]:
    """Share of every tissue that is there."""
    shares: dict[Tissue, float] = {}
    for entry in contents:
        if entry["share"] is not None:
            tissue = Tissue[entry["tissue"].upper()]
            shares[tissue] = shares.get(tissue, 0.0) + entry["share"]
    return shares


def table(contents: tuple[dict[str, Any], ...]) -> str:
    """Values, tissues, volumes and shares in columns."""
    rows = [("value", "tissue", "ml", "share")]
    for e in contents:
        share = "" if e["share"] is None else f"{100 * e['share']:.2f} %"
        rows.append((str(e["value"]), e["tissue"], f"{e['ml']:.2f}", share))
    widths = [max(len(row[k]) for row in rows) for k in range(4)]
    return "\n".join(
        f"{a:>{widths[0]}}  {b:<{widths[1]}}  {c:>{widths[2]}}  {d:>{widths[3]}}".rstrip() for a, b, c, d in rows
    )


def _doubts(
    contents: tuple[dict[str, Any], ...], shares: dict[Tissue, float], anatomy: Anatomy, confirmed: bool
) -> Iterator[str]:
    """What is odd. raises: SpecError where the tissue map must be wrong, unless it is confirmed"""
    if not shares:
        return
    dense = any(tissue in shares for tissue in DENSE)
    strong = []
    if not dense and Tissue.ADIPOSE not in shares:
        strong.append("it has no fat and no gland")
    cover = sum(entry["voxels"] for entry in contents if entry["tissue"] in {t.name.lower() for t in COVER})
    if anatomy.covered < min(COVERED * anatomy.surface, OUTSIDE * cover):
        strong.append(f"only {anatomy.covered / anatomy.surface:.0%} of its surface is skin: its skin lies inside")
    if strong and not confirmed:
        _refuse_tissues(" and ".join(strong), contents)
    yield from (f"doubtful: {words}" for words in strong)
    if not dense and Tissue.ADIPOSE in shares:
        yield "doubtful: no value is gland"
    if dense and Tissue.ADIPOSE not in shares:
        yield "doubtful: no value is fat"
    if Tissue.SKIN not in shares:
        yield "no value is skin"
    for tissue, most in MOST.items():
        if shares.get(tissue, 0.0) > most:
            yield f"doubtful: {shares[tissue]:.0%} of the tissue is {tissue.name.lower()}"


def _refuse_tissues(words: str, contents: tuple[dict[str, Any], ...]) -> None:
    listed = ", ".join(f"{e['value']} = {e['tissue']} ({e['ml']:.3g} ml)" for e in contents)
    message = (
        f"this is hardly a breast, {words}; as read: {listed}. Say which tissue each value is (--tissue-map, tissues: "
        f"{', '.join(tissue_maps.BUILT_IN)}, or a map of your own), or confirm it (--confirm-tissues, "
        "confirm_tissues = true)"
    )
    raise SpecError(
        f"phantom.tissues: {message}",
        code="upload-doubtful-tissues",
        problems=[{"field": "tissues", "value": None, "message": message}],
    )


def _check_planes(planes: dict[str, int]) -> None:
    thin = {name: n for name, n in planes.items() if n < LEAST_PLANES}
    if thin:
        said = " and ".join(f"{n} voxel{'s' * (n > 1)} along {name}" for name, n in sorted(thin.items()))
        raise refused(
            "shape",
            None,
            f"the tissue is {said}; a breast that is to be compressed has at least {LEAST_PLANES} along every axis: "
            "give a whole volume with smaller voxels, or one that is already compressed (--compressed, compressed = "
            "true)",
        )


def _plates(
    scan: Survey, first: int, behind: int, single: bool, stray: float, thickness: float, axis: int, voxel_mm3: float
) -> Iterator[str]:
    other = "; the file has one plate, the other is taken where the tissue ends" if single else ""
    yield f"the plates in the file are {thickness:g} mm apart, which is the compressed thickness{other}"
    outside = scan.body_voxels - int(scan.areas[axis][first:behind].sum())
    if outside:
        yield f"{outside * voxel_mm3 * 1e-3:.3g} ml of tissue above and below the plates are cut off"
    if stray > 0.01:
        yield f"{stray:.0%} of the plates' voxels lie outside of their planes and are taken for air"
