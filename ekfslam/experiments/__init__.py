"""Experiments: many estimators on the same data."""

from ekfslam.experiments.association import AssociationStudy, association_study
from ekfslam.experiments.compare import Comparison, compare

__all__ = ["AssociationStudy", "Comparison", "association_study", "compare"]
