"""The lesions as boxes in the volume, in the table format of the breast tomosynthesis lesion detection challenge."""

from __future__ import annotations

import csv
import io

from simcore.dicom.common import patient_id
from simcore.dicom.study import Study

COLUMNS = ("PatientID", "StudyUID", "View", "Slice", "X", "Y", "Width", "Height", "VolumeSlices")


def truth_table(study: Study) -> str:
    """CSV with one line a lesion; the heading alone where there is none in the volume.

    Slice: the middle slice of the lesion; X, Y: column and row of the upper left pixel of its box, all counted from 0
    in the frames of the tomosynthesis object as they are stored. View: lcc, rmlo, ...
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    view = (study.spec.laterality + study.spec.view).lower()
    for lesion in study.lesions:
        if not len(lesion.voxels):
            continue
        (z0, y0, x0), (z1, y1, x1) = lesion.first, lesion.last
        table.writerow(
            (
                patient_id(study.spec, study.case),
                study.ids.study,
                view,
                (z0 + z1) // 2,
                x0,
                y0,
                x1 - x0 + 1,
                y1 - y0 + 1,
                study.volume.grid.shape[0],
            )
        )
    return text.getvalue()
