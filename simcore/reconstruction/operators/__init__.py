"""Projection and back-projection of slices, and what iterative methods do between them. Numba kernels."""
