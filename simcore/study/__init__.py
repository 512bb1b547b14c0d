"""Families of cases: one base specification and axes (simcore.study.expansion makes their cases)."""

from simcore.study.spec import StudySpec

__all__ = ["StudySpec"]
