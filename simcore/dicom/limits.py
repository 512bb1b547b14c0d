"""What one DICOM object can hold; nothing here loads a library."""

from __future__ import annotations

MAX_BYTES = 2**32 - 2
"""What the length of an element, and the offsets of encoded frames, can tell."""


def pixel_bytes(frames: int, rows: int, columns: int, bytes_per_pixel: int, encoding: str) -> int:
    """Bytes of pixel data, at most.

    Plain and JPEG-LS: those of the pixels themselves (real images shrink in JPEG-LS). RLE of noise may grow: by the
    count that stands before every 128 bytes, and by the headers of frames and of items.
    """
    if encoding != "rle":
        return frames * rows * columns * bytes_per_pixel
    row = columns + columns // 128 + 2
    return frames * (8 + 64 + bytes_per_pixel * (rows * row + 1))
