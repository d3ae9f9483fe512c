"""GTSAM smoothers and other baselines; the only package that imports gtsam."""
