"""The tangent, and linear systems with it."""
