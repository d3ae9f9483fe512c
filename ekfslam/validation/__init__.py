"""The ladder behind `ekfslam check`: what a right estimator must show."""

from ekfslam.validation.ladder import Report, Rung, check

__all__ = ["Report", "Rung", "check"]
