"""The lesions as boxes in the volume, in the tables of the breast tomosynthesis lesion detection challenge.

Its reader (``dcmread_image`` of github.com/mazurowski-lab/duke-dbt-data) looks at the sums of the first and the last
column of a slice: where the larger one is not on the side that the view names, it turns the volume by 180 degrees.
Stored slices have the chest wall in column 0, so right breasts are turned, and boxes are drawn after that.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

import numpy as np

from simcore.dicom.common import patient_id
from simcore.dicom.lesions import Lesion
from simcore.dicom.study import Study

COLUMNS = ("PatientID", "StudyUID", "View", "Slice", "X", "Y", "Width", "Height", "VolumeSlices", "StoredX", "StoredY")
PATH_COLUMNS = ("PatientID", "StudyUID", "View", "descriptive_path", "classic_path")


def truth_table(study: Study) -> str:
    """CSV with one line a lesion; the heading alone where there is none in the volume.

    Slice: the middle slice of the lesion, from 0. X, Y: column and row, from 0, of the upper left pixel of its box in
    the slice as the challenge's reader gives it. StoredX, StoredY: the same in the frames of the tomosynthesis object
    as they are stored. View: lcc, rmlo, ...
    """
    return _table(COLUMNS, (_row(study, lesion) for lesion in study.lesions if len(lesion.voxels)))


def path_table(study: Study, file: str) -> str:
    """CSV with the one line that joins the boxes with the file of the volume, below the folder of the case."""
    return _table(PATH_COLUMNS, [(*_key(study), file, file)])


def reader_notes(study: Study) -> Iterator[str]:
    """Where the reader would turn a slice alone and the whole volume differently."""
    whole = is_turned(study, 0)
    for lesion in study.lesions:
        if len(lesion.voxels) and is_turned(study, _slice(lesion)) != whole:
            yield (
                f"truth.csv: the challenge's reader turns slice {_slice(lesion)}, which the box of {lesion.name} is "
                f"drawn in, {'not ' * whole}by 180 degrees, but the whole volume {'not ' * (not whole)}so: read the "
                "slice alone (index), or use StoredX and StoredY"
            )


def is_turned(study: Study, k: int) -> bool:
    """Whether the challenge's reader turns slice ``k`` by 180 degrees."""
    plane = study.volume.data[k]
    first, last = (int(np.sum(plane[:, column], dtype=np.int64)) for column in (0, -1))
    return ("R" if first < last else "L") != study.spec.laterality


def _key(study: Study) -> tuple[str, str, str]:
    return patient_id(study.spec, study.case), study.ids.study, (study.spec.laterality + study.spec.view).lower()


def _slice(lesion: Lesion) -> int:
    return (lesion.first[0] + lesion.last[0]) // 2


def _row(study: Study, lesion: Lesion) -> tuple[str | int, ...]:
    (_, y0, x0), (_, y1, x1) = lesion.first, lesion.last
    slices, rows, columns = study.volume.grid.shape
    turned = is_turned(study, _slice(lesion))
    x, y = (columns - 1 - x1, rows - 1 - y1) if turned else (x0, y0)
    return (*_key(study), _slice(lesion), x, y, x1 - x0 + 1, y1 - y0 + 1, slices, x0, y0)


def _table(columns: Sequence[str], rows: Iterator[tuple[str | int, ...]] | list[tuple[str, ...]]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(columns)
    table.writerows(rows)
    return text.getvalue()
