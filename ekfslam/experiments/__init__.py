"""Experiments: many estimators on the same data."""

from ekfslam.experiments.association import AssociationStudy, association_study
from ekfslam.experiments.compare import Comparison, compare
from ekfslam.experiments.partial import PartialStudy, partial_study

__all__ = [
    "AssociationStudy",
    "Comparison",
    "PartialStudy",
    "association_study",
    "compare",
    "partial_study",
]
