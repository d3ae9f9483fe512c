"""Figures of one run from its tidy tables; needs neither a display nor an estimator."""

from ekfslam.plots.consistency import plot_consistency
from ekfslam.plots.maps import plot_map
from ekfslam.plots.series import plot_errors, plot_times
from ekfslam.plots.study import plot_study
from ekfslam.plots.style import COLUMN, PAGE, look, looks, save, style

__all__ = [
    "COLUMN",
    "PAGE",
    "look",
    "looks",
    "plot_consistency",
    "plot_errors",
    "plot_map",
    "plot_study",
    "plot_times",
    "save",
    "style",
]
