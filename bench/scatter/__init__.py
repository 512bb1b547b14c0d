"""Scatter and dose against analog photons."""
