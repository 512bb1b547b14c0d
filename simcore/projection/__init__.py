"""Tomosynthesis projections of a label volume: geometry, line integrals, detector signal."""

from simcore.projection.acquisition import geometry_of
from simcore.projection.integrals import line_integrals
from simcore.projection.materials import attenuation_table
from simcore.projection.stage import project

__all__ = ["attenuation_table", "geometry_of", "line_integrals", "project"]
