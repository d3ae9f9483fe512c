"""Experiments: many estimators on the same data."""

from ekfslam.experiments.compare import Comparison, compare

__all__ = ["Comparison", "compare"]
