"""How a file that is added is to be read, as far as it does not say so itself."""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationError

from simcore.core.errors import SpecError
from simcore.core.spec_base import Spec
from simcore.phantom.upload.spec import OWN_AXES, Axes, Count, Edge
from simcore.phantom.upload.tissue_maps import TissueMap

if TYPE_CHECKING:
    from simcore.phantom.upload.formats.header import Encoding, Header


class RawHeader(Spec):
    """What is not in a file of raw voxels (.raw, .raw.gz)."""

    shape: tuple[Count, Count, Count] = Field(
        strict=False, description="voxels along the axes of the array, slowest first [1]"
    )
    spacing_mm: tuple[Edge, Edge, Edge] = Field(
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="voxel edges along the axes of the array, slowest first [mm]",
    )
    axes: Axes = Field(OWN_AXES, strict=False, description="where each axis of the array leads, slowest first")
    dtype: Literal["int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64"] = (
        Field("uint8", description="type of a voxel; its labels are whole numbers")
    )
    byte_order: Literal["little", "big"] = Field("little", description="order of the bytes of a voxel")
    header_bytes: Annotated[int, Field(ge=0, le=2**24)] = Field(
        0, description="bytes before the voxels, once unpacked where they are gzip-compressed [byte]"
    )

    def header(self, voxels: IO[bytes]) -> Header:
        """That of the voxels in a file, gzip-compressed or not."""
        # Here and not above: clients say how a file is to be read, and need no numerics.
        import numpy as np

        from simcore.phantom.upload.formats.decoding import begins_with_gzip
        from simcore.phantom.upload.formats.header import Header

        encoding: Encoding = "gzip" if begins_with_gzip(voxels) else "raw"
        dtype = np.dtype(self.dtype).newbyteorder("<" if self.byte_order == "little" else ">")
        return Header("raw", self.shape, self.spacing_mm, self.axes, dtype, encoding, 0, skip=self.header_bytes)


class Reading(Spec):
    """Everything has a default but for raw voxels, which need ``raw``."""

    tissues: TissueMap | None = Field(
        None,
        description="tissue of every value, as in a specification; by the names of its segments where the file has "
        "them (3D Slicer), or 'victre'",
    )
    compressed: bool = Field(False, description="whether the phantom is already compressed along z")
    axes: Axes | None = Field(
        None,
        strict=False,
        description="where each axis of the array leads, slowest first; as the file says",
    )
    spacing_mm: tuple[Edge, Edge, Edge] | None = Field(
        None,
        strict=False,
        json_schema_extra={"unit": "mm"},
        description="voxel edges along the axes of the array, slowest first; as the file says [mm]",
    )
    confirm_size: bool = Field(
        False, description="whether a breast below 20 ml or above 5 l is one, and not one with voxels in another unit"
    )
    confirm_tissues: bool = Field(
        False, description="whether the tissues are right, though hardly those of a breast as they are read"
    )
    raw: RawHeader | None = Field(None, description="header of raw voxels (.raw, .raw.gz)")

    @classmethod
    def parse(cls, text: str | bytes) -> Reading:
        """From JSON. raises: SpecError naming every wrong field"""
        try:
            return cls.model_validate_json(text)
        except ValidationError as error:
            problems = [
                {"field": ".".join(map(str, e["loc"])) or "(all of it)", "value": None, "message": e["msg"]}
                for e in error.errors(include_url=False)
            ]
            said = "; ".join(f"{p['field']}: {p['message']}" for p in problems)
            raise SpecError(f"how the file is to be read is not valid: {said}", problems=problems) from None
