"""The ladder behind `ekfslam check`: what a right estimator must show, and what is wrong if not."""

from ekfslam.validation.diagnosis import Finding, diagnose
from ekfslam.validation.ladder import Report, Rung, check

__all__ = ["Finding", "Report", "Rung", "check", "diagnose"]
