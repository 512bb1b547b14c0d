"""Orientations that are tilted by some degrees against the patient, in NIfTI, as scanners and registrations leave them."""

import numpy as np
from nifti_by_hand import nifti
from synth import breast

a = breast(mm=2.0)
d = "files/r17/"


def of_quaternion(b, c, q):
    """The rotation of a NIfTI quaternion (nifti1.h)."""
    s = np.sqrt(max(0.0, 1 - b * b - c * c - q * q))
    return np.array(
        [
            [s * s + b * b - c * c - q * q, 2 * (b * c - s * q), 2 * (b * q + s * c)],
            [2 * (b * c + s * q), s * s + c * c - b * b - q * q, 2 * (c * q - s * b)],
            [2 * (b * q - s * c), 2 * (c * q + s * b), s * s + q * q - b * b - c * c],
        ]
    )


affine = np.eye(4)
affine[:3, :3] = 2 * of_quaternion(-0.0072, -0.9995, 0.0243)  # 2.3, 2.9 and 3.5 degrees
nifti(d + "tilt3.nii.gz", a, affine)
for degrees in (1, 2, 2.5, 2.6, 3):
    t = np.radians(degrees)
    affine[:3, :3] = 2 * np.array([[np.cos(t), -np.sin(t), 0], [np.sin(t), np.cos(t), 0], [0, 0, 1]])
    nifti(d + f"tilt_{degrees}.nii.gz", a, affine)
affine[:3, :3] = [[2, 0.2, 0], [0, 2, 0], [0, 0, 2]]
nifti(d + "sheared.nii.gz", a, affine)
nifti(d + "bigendian16.nii", a.astype(">i2"), np.diag([2, 2, 2, 1.0]))
