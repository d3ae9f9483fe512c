"""Experiments: many estimators on the same data."""

from ekfslam.experiments.association import AssociationStudy, association_study
from ekfslam.experiments.campaign import Campaign
from ekfslam.experiments.compare import compare
from ekfslam.experiments.comparison import Comparison
from ekfslam.experiments.partial import PartialStudy, partial_study
from ekfslam.experiments.reading import load_campaign
from ekfslam.experiments.recorded import RecordedStudy, recorded_study
from ekfslam.experiments.results import CampaignResults, read_campaign
from ekfslam.experiments.running import run_campaign

__all__ = [
    "AssociationStudy",
    "Campaign",
    "CampaignResults",
    "Comparison",
    "PartialStudy",
    "RecordedStudy",
    "association_study",
    "compare",
    "load_campaign",
    "partial_study",
    "read_campaign",
    "recorded_study",
    "run_campaign",
]
