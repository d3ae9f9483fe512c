"""One page of a finished experiment: self-contained HTML, made from its folder of results alone."""

from ekfslam.report.page import write_report

__all__ = ["write_report"]
