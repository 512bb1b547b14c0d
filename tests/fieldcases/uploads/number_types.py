"""How common tools write labels: nibabel (nii), pynrrd and SimpleITK, each header as the tool writes it, by hand."""

import gzip
import zlib

import numpy as np
from nifti_by_hand import OURS, nifti, nifti_2
from synth import breast, nrrd

a = breast(mm=2.0)
d = "files/r14/"
TYPES = {"u8": "u1", "i8": "i1", "i16": "<i2", "u16": "<u2", "i32": "<i4", "u32": "<u4", "f32": "<f4", "f64": "<f8",
         "i64": "<i8", "u64": "<u8"}  # fmt: skip

# nibabel
for name, dtype in TYPES.items():
    nifti(d + f"nii_{name}.nii.gz", a.astype(dtype))
# get_fdata() saved with the header of whole numbers: the range is stretched over that of the type, with a slope
for name, dtype, largest in (("u16", "<u2", 65535), ("u8", "u1", 255)):
    slope = a.max() / largest
    nifti(d + f"nii_fdata_{name}.nii.gz", np.rint(a / slope).astype(dtype), slope=(slope, 0.0))
nifti(d + "nii_slope1.nii", a)
nifti(d + "nii_nanslope.nii", a, slope=(float("nan"), 0.0))
nifti(d + "nii_slope_half.nii", a * 2, slope=(0.5, 0.0))
nifti(d + "nii_slope_tenth.nii", a.astype("<u2") * 10, slope=(0.1, 0.0))
nifti(d + "nii_inter.nii", (a.astype(int) - 100).astype("i1"), slope=(1.0, 100.0))
nifti_2(d + "nifti2.nii", a)
nifti(d + "bigendian.nii", a.astype(">f4"))
nifti(d + "nii_4d1.nii.gz", a, sizes=(*a.shape[::-1], 1))
nifti(d + "nii_4d2.nii.gz", np.stack([a, a]), sizes=(*a.shape[::-1], 2))
nifti(d + "gzip_as.nii", a)
with open(d + "gzip_as.nii", "rb") as plain:
    packed = gzip.compress(plain.read())
with open(d + "gzip_as.nii", "wb") as target:
    target.write(packed)
# a pair: the header says so, the voxels are beside it
nifti(d + "pair.hdr", a)
with open(d + "pair.hdr", "rb") as whole:
    head = bytearray(whole.read(348))
head[344:348] = b"ni1\0"
with open(d + "pair.hdr", "wb") as target:
    target.write(head)
with open(d + "pair.img", "wb") as target:
    target.write(a.tobytes())
# transforms that contradict the voxel size, or one another
nifti(d + "sform1_pixdim2.nii", a, affine=OURS / [[2], [2], [2], [1]], codes=(0, 1))
nifti(d + "eye.nii", a, affine=np.eye(4))
nifti(d + "noaffine.nii", a, edge=1.0, codes=(0, 0))
nifti(d + "both.nii", a, codes=(1, 1), quaternion=(0.0, 0.0, 0.5**0.5))
nifti(d + "both_differ.nii", a, codes=(1, 1), quaternion=(0.0, 0.0, 0.0))

# pynrrd
for name in ("i64", "f32", "f64", "u64"):
    kind = {"i64": "int64", "f32": "float", "f64": "double", "u64": "uint64"}[name]
    nrrd(d + f"pynrrd_{name}.nrrd", a.astype(TYPES[name]), (2, 2, 2), type=kind, encoding="gzip")

# SimpleITK
LPS = ["space: left-posterior-superior", "space directions: (2,0,0) (0,2,0) (0,0,2)", "kinds: domain domain domain",
       "space origin: (0,0,0)"]  # fmt: skip
for name in ("i64", "f32", "f64", "u8"):
    kind = {"i64": "long long int", "f32": "float", "f64": "double", "u8": "unsigned char"}[name]
    element = {"i64": "LONG_LONG", "f32": "FLOAT", "f64": "DOUBLE", "u8": "UCHAR"}[name]
    b = a.astype(TYPES[name])
    nrrd(d + f"sitk_{name}.nrrd", b, type=kind, encoding="gzip", extra=LPS)
    nifti(d + f"sitk_{name}.nii.gz", b, affine=np.diag([-2, -2, 2, 1]), codes=(1, 1), quaternion=(0, 0, 1), units=10)

    def meta(path, packed, where, data, element=element):
        size = f"CompressedDataSize = {len(data)}\n" if packed else ""
        head = (
            f"ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nCompressedData = {packed}\n"
            f"{size}TransformMatrix = 1 0 0 0 1 0 0 0 1\nOffset = 0 0 0\nCenterOfRotation = 0 0 0\n"
            f"AnatomicalOrientation = RAI\nElementSpacing = 2 2 2\nDimSize = {a.shape[2]} {a.shape[1]} {a.shape[0]}\n"
            f"ElementType = MET_{element}\nElementDataFile = {where}\n"
        )
        with open(path, "wb") as file:
            file.write(head.encode() + (data if where == "LOCAL" else b""))

    meta(d + f"sitk_{name}.mha", False, "LOCAL", b.tobytes())
    if name == "u8":
        meta(d + "sitk_u8c.mha", True, "LOCAL", zlib.compress(a.tobytes()))
        meta(d + "sitk_u8c.mhd", True, "sitk_u8c.zraw", zlib.compress(a.tobytes()))
        with open(d + "sitk_u8c.zraw", "wb") as target:
            target.write(zlib.compress(a.tobytes()))
        with open(d + "sitk_u8.nhdr", "w") as target:
            fields = ["NRRD0004", "type: unsigned char", "dimension: 3", *LPS[:2], "encoding: raw", LPS[3]]
            fields += ["sizes: " + " ".join(map(str, a.shape[::-1])), "data file: sitk_u8.raw", ""]
            target.write("\n".join(fields))
        with open(d + "sitk_u8.raw", "wb") as target:
            target.write(a.tobytes())

