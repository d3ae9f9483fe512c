"""Errors, consistency and tables of estimates; needs neither an estimator nor matplotlib."""

from ekfslam.evaluation.association import (
    AssociationScores,
    LandmarkCounts,
    association_scores,
    count_landmarks,
)
from ekfslam.evaluation.consistency import (
    judged,
    pose_nees,
    pose_nees_invariant,
    squared_mahalanobis,
)
from ekfslam.evaluation.landmarks import match_landmarks
from ekfslam.evaluation.statistics import chi2_interval, share_inside
from ekfslam.evaluation.trajectory import (
    absolute_errors,
    alignment_motion,
    frame_motion,
    path_length,
    relative_errors,
)

__all__ = [
    "AssociationScores",
    "LandmarkCounts",
    "absolute_errors",
    "alignment_motion",
    "association_scores",
    "chi2_interval",
    "count_landmarks",
    "frame_motion",
    "judged",
    "match_landmarks",
    "path_length",
    "pose_nees",
    "pose_nees_invariant",
    "relative_errors",
    "share_inside",
    "squared_mahalanobis",
]
