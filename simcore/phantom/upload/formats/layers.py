"""Arrays of more than three axes: axes of one entry are dropped, others are explained."""

from __future__ import annotations

from collections.abc import Sequence

from simcore.core.errors import SpecError
from simcore.phantom.upload.formats.header import refuse


def volume_axes(sizes: Sequence[int], lists: Sequence[int] = ()) -> list[int]:
    """Which axes, fastest first, are the three of the volume.

    sizes: of all axes, fastest first. lists: axes that the file calls none of space.
    raises: SpecError where there are fewer, or voxels of more than one number.
    """
    kept = list(range(len(sizes)))
    if len(sizes) - len(lists) == 3:
        dropped = list(lists)
    else:
        last = [k for k in reversed(kept) if sizes[k] == 1 and all(sizes[j] == 1 for j in kept[k:])]
        first = [k for k in kept if sizes[k] == 1 and all(sizes[j] == 1 for j in kept[:k])]
        dropped = list(dict.fromkeys([*last, *first]))[: max(0, len(sizes) - 3)]
    kept = [k for k in kept if k not in dropped]
    if len(kept) != 3 or any(sizes[k] != 1 for k in dropped):
        raise _explained(sizes, dropped if len(kept) == 3 else [])
    return kept


def _explained(sizes: Sequence[int], lists: Sequence[int]) -> SpecError:
    shown = " x ".join(map(str, sizes))
    if len(sizes) < 3:
        return refuse(f"it has {len(sizes)} axes ({shown}); a volume has 3: join the slices to one volume first")
    layers = next((k for k in lists if sizes[k] != 1), 0 if sizes[0] < sizes[-1] else len(sizes) - 1)
    number = sizes[layers]
    named = f"it has {len(sizes)} axes ({shown}): {number} layers of a volume; one label a voxel is needed"
    if layers == 0:
        return refuse(
            f"{named}. 3D Slicer writes layers where segments overlap: export the segmentation there to a label map "
            "(Segmentations, Export to files, or Export to labelmap) and add that; a colour image (RGB) is no label map"
        )
    return refuse(f"{named}: save one of them (in Python volume[..., 0]) and add that")
