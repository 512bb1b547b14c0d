"""What each stage needs, measured on the paper's case (docs/performance.md); good to some 20 %."""

from __future__ import annotations

from simcore.pipeline.graph import Needs, Sizes
from simcore.spec import SimulationSpec

MESH_SECONDS_PER_TETRAHEDRON = {"tetwild": 5e-4, "lattice": 2e-5}
VOXELS_PER_SECOND = 150e6
SECONDS_PER_RAY_OF_TRANSPORT = 2e-6
STORED_BYTES_PER_LABEL = 0.05


def phantom(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(sizes.voxels / VOXELS_PER_SECOND, STORED_BYTES_PER_LABEL * sizes.voxels)


def mesh(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(MESH_SECONDS_PER_TETRAHEDRON[spec.mesh.kind] * sizes.tetrahedra)


def fem(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(0.0 if spec.phantom.compressed else 1.0)


def warp(spec: SimulationSpec, sizes: Sizes) -> Needs:
    voxels = sizes.compressed_voxels
    return Needs(2 * voxels / VOXELS_PER_SECOND, STORED_BYTES_PER_LABEL * voxels)


def projection(spec: SimulationSpec, sizes: Sizes) -> Needs:
    if spec.physics.kind == "xray":
        return Needs(3 * sizes.ray_seconds, 6 * sizes.pixels)
    return Needs(sizes.ray_seconds, 2 * sizes.pixels)


def transport(spec: SimulationSpec, sizes: Sizes) -> Needs:
    if spec.physics.kind != "xray":
        return Needs(0.0)
    setting = spec.physics.transport
    rays = (setting.rays_per_view + setting.equivalent_breast_rays_per_view) * spec.acquisition.views
    return Needs(1.5 * rays * SECONDS_PER_RAY_OF_TRANSPORT, 1e6)


def detection(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(6e-8 * sizes.pixels, 2 * sizes.pixels)


def reconstruction(spec: SimulationSpec, sizes: Sizes) -> Needs:
    stored = 2 * sizes.volume if spec.reconstruction.is_kept else 0.0
    return Needs(3e-8 * sizes.pixels + 1e-9 * sizes.worked * spec.acquisition.views, stored)


def dicom(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(4e-8 * sizes.pixels + sizes.output_bytes / 3e8, sizes.output_bytes)


def small(spec: SimulationSpec, sizes: Sizes) -> Needs:
    return Needs(0.5)
