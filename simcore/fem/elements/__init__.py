"""Linear tetrahedra: geometry, kernels of forces and tangents, and the model of a breast."""
