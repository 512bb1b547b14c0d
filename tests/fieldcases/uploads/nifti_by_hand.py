"""NIfTI-1 and NIfTI-2 as nibabel writes them, without nibabel: voxels, affine, and what a case changes of the header."""

from __future__ import annotations

import gzip
import struct

import numpy as np

CODES = {"u1": 2, "i2": 4, "i4": 8, "f4": 16, "f8": 64, "i1": 256, "u2": 512, "u4": 768, "i8": 1024, "u8": 1280}
OURS = np.array([[0, -2, 0, 0], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1.0]])
"""Array axis 0 leads to anterior, 1 to left (-R), 2 to superior; 2 mm."""


def nifti(path, labels, affine=OURS, edge=2.0, slope=(1.0, 0.0), codes=(0, 2), sizes=None, quaternion=(0, 0, 0), units=0):
    """labels: (z, y, x). edge: of pixdim. codes: of qform and sform. sizes: of all axes, fastest first."""
    order = ">" if labels.dtype.str[0] == ">" else "<"
    sizes = sizes or labels.shape[::-1]
    head = bytearray(352)
    struct.pack_into(f"{order}i", head, 0, 348)
    struct.pack_into(f"{order}8h", head, 40, len(sizes), *sizes, *[1] * (7 - len(sizes)))
    struct.pack_into(f"{order}2h", head, 70, CODES[labels.dtype.str[1:]], 8 * labels.itemsize)
    struct.pack_into(f"{order}8f", head, 76, 1.0, edge, edge, edge, 1, 1, 1, 1)
    struct.pack_into(f"{order}3f", head, 108, 352, *slope)
    head[123] = units
    struct.pack_into(f"{order}2h", head, 252, *codes)
    struct.pack_into(f"{order}3f", head, 256, *quaternion)
    struct.pack_into(f"{order}12f", head, 280, *np.asarray(affine, float)[:3].ravel())
    head[344:348] = b"n+1\0"
    data = bytes(head) + labels.tobytes()
    with open(path, "wb") as file:
        file.write(gzip.compress(data, 1) if str(path).endswith(".gz") else data)


def nifti_2(path, labels, affine=OURS, edge=2.0):
    order = ">" if labels.dtype.str[0] == ">" else "<"
    head = bytearray(544)
    struct.pack_into(f"{order}i8s2h", head, 0, 540, b"n+2\0\r\n\x1a\n", CODES[labels.dtype.str[1:]], 8 * labels.itemsize)
    struct.pack_into(f"{order}8q", head, 16, 3, *labels.shape[::-1], 1, 1, 1, 1)
    struct.pack_into(f"{order}8d", head, 104, 1.0, edge, edge, edge, 1, 1, 1, 1)
    struct.pack_into(f"{order}q2d", head, 168, 544, 1.0, 0.0)
    struct.pack_into(f"{order}2i", head, 344, 0, 2)
    struct.pack_into(f"{order}12d", head, 400, *np.asarray(affine, float)[:3].ravel())
    with open(path, "wb") as file:
        file.write(bytes(head) + labels.tobytes())
