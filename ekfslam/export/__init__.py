"""Records in formats that other programs read."""

from ekfslam.export.graph import write_g2o
from ekfslam.export.rerun_file import write_rerun
from ekfslam.export.tum import write_tum

__all__ = ["write_g2o", "write_rerun", "write_tum"]
