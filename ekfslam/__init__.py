"""Workbench that compares hand-written EKF-SLAM with GTSAM smoothers of the same landmark graph."""
