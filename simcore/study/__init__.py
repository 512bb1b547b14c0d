"""Studies: families of cases from a base specification and axes."""

from simcore.study.expansion import Case, columns, expand
from simcore.study.spec import StudySpec

__all__ = ["Case", "StudySpec", "columns", "expand"]
