"""Errors, consistency and tables of estimates; needs neither an estimator nor matplotlib."""

from ekfslam.evaluation.association import (
    AssociationScores,
    LandmarkCounts,
    association_scores,
    count_landmarks,
)
from ekfslam.evaluation.consistency import (
    pose_nees,
    pose_nees_invariant,
    squared_mahalanobis,
)
from ekfslam.evaluation.landmarks import match_landmarks
from ekfslam.evaluation.monte_carlo import runs_needed, summarise
from ekfslam.evaluation.over_time import credibility, nees_over_time
from ekfslam.evaluation.paired import compare_pairs
from ekfslam.evaluation.run_metrics import run_metrics
from ekfslam.evaluation.statistics import chi2_interval, share_inside
from ekfslam.evaluation.trajectory import (
    absolute_errors,
    alignment_motion,
    frame_motion,
    path_length,
    relative_errors,
)
from ekfslam.evaluation.verdict import judged

__all__ = [
    "AssociationScores",
    "LandmarkCounts",
    "absolute_errors",
    "alignment_motion",
    "association_scores",
    "chi2_interval",
    "compare_pairs",
    "count_landmarks",
    "credibility",
    "frame_motion",
    "judged",
    "match_landmarks",
    "nees_over_time",
    "path_length",
    "pose_nees",
    "pose_nees_invariant",
    "relative_errors",
    "run_metrics",
    "runs_needed",
    "share_inside",
    "squared_mahalanobis",
    "summarise",
]
