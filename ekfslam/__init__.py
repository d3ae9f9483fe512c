"""Workbench that compares hand-written EKF-SLAM with GTSAM smoothers of the same landmark graph.

Names are imported when they are first used, so that ``import ekfslam`` costs nothing.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the same names for type checkers and editors
    from pathlib import Path

    from ekfslam.dataset import Dataset as Dataset
    from ekfslam.dataset import LandmarkMap as LandmarkMap
    from ekfslam.dataset import Observations as Observations
    from ekfslam.dataset import Prior as Prior
    from ekfslam.dataset import Robot as Robot
    from ekfslam.dataset import Sightings as Sightings
    from ekfslam.datasets.table_columns import to_tables as to_tables
    from ekfslam.datasets.table_files import write_tables as write_tables
    from ekfslam.datasets.tables import from_tables as from_tables
    from ekfslam.errors import EkfslamError as EkfslamError
    from ekfslam.errors import FileFormatError as FileFormatError
    from ekfslam.errors import InputError as InputError
    from ekfslam.errors import UnknownNameError as UnknownNameError
    from ekfslam.errors import UnsupportedError as UnsupportedError
    from ekfslam.estimates import Decision as Decision
    from ekfslam.estimates import Estimate as Estimate
    from ekfslam.estimates import Innovations as Innovations
    from ekfslam.estimates import LandmarkEstimates as LandmarkEstimates
    from ekfslam.estimates import Trajectory as Trajectory
    from ekfslam.experiments import Campaign as Campaign
    from ekfslam.experiments import CampaignResults as CampaignResults
    from ekfslam.experiments import Comparison as Comparison
    from ekfslam.experiments import association_study as association_study
    from ekfslam.experiments import load_campaign as load_campaign
    from ekfslam.experiments import read_campaign as read_campaign
    from ekfslam.experiments import run_campaign as run_campaign
    from ekfslam.experiments.compare import compare as compare
    from ekfslam.experiments.film import animate as animate
    from ekfslam.filters.ekf import Ekf as Ekf
    from ekfslam.filters.online import EkfSlam as EkfSlam
    from ekfslam.models.motion import MotionModel as MotionModel
    from ekfslam.models.sensors import Sensor as Sensor
    from ekfslam.own_models import OwnMotion as OwnMotion
    from ekfslam.own_models import propagated as propagated
    from ekfslam.simulation import RobotPlan as RobotPlan
    from ekfslam.simulation import Scenario as Scenario
    from ekfslam.simulation import SensorPlan as SensorPlan
    from ekfslam.simulation import load_scenario as load_scenario
    from ekfslam.simulation.simulate import simulate as simulate
    from ekfslam.validation import check as check

__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())  # who wants to hear adds another

_HOMES = {
    "Campaign": "ekfslam.experiments",
    "CampaignResults": "ekfslam.experiments",
    "Comparison": "ekfslam.experiments",
    "Dataset": "ekfslam.dataset",
    "Decision": "ekfslam.estimates",
    "Ekf": "ekfslam.filters.ekf",
    "EkfSlam": "ekfslam.filters.online",
    "EkfslamError": "ekfslam.errors",
    "Estimate": "ekfslam.estimates",
    "FileFormatError": "ekfslam.errors",
    "Innovations": "ekfslam.estimates",
    "InputError": "ekfslam.errors",
    "LandmarkEstimates": "ekfslam.estimates",
    "LandmarkMap": "ekfslam.dataset",
    "MotionModel": "ekfslam.models.motion",
    "Observations": "ekfslam.dataset",
    "OwnMotion": "ekfslam.own_models",
    "Prior": "ekfslam.dataset",
    "Robot": "ekfslam.dataset",
    "RobotPlan": "ekfslam.simulation",
    "Scenario": "ekfslam.simulation",
    "Sensor": "ekfslam.models.sensors",
    "SensorPlan": "ekfslam.simulation",
    "Sightings": "ekfslam.dataset",
    "Trajectory": "ekfslam.estimates",
    "UnknownNameError": "ekfslam.errors",
    "UnsupportedError": "ekfslam.errors",
    "animate": "ekfslam.experiments.film",
    "association_study": "ekfslam.experiments",
    "check": "ekfslam.validation",
    "compare": "ekfslam.experiments",
    "from_tables": "ekfslam.datasets.tables",
    "load_campaign": "ekfslam.experiments",
    "load_scenario": "ekfslam.simulation",
    "propagated": "ekfslam.own_models",
    "read_campaign": "ekfslam.experiments",
    "run_campaign": "ekfslam.experiments",
    "simulate": "ekfslam.simulation",
    "to_tables": "ekfslam.datasets.table_columns",
    "write_tables": "ekfslam.datasets.table_files",
}

__all__ = [*_HOMES, "estimate", "load"]


if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module 'ekfslam' has no attribute {name!r}")
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])


def load(source: str | Path, path: str | Path | None = None, **options: Any) -> Dataset:
    """Load a recorded set by name, a dataset file (``.npz``), or a folder of tables.

    Parameters
    ----------
    source : str or path
        As for `compare`; the text may hold options, too: ``victoria-park(noise=file)``.
    path : path, optional
        Where the files of a recorded set lie, if they do not come with a package.
    **options
        Of the loader of a recorded set, such as ``odometry_sigmas=(0.05, 0.05, 0.005)`` for
        ``victoria-park``.

    Raises
    ------
    UnknownNameError, FileFormatError, InputError
        For what cannot be found or read, or an option that there is not.
    """
    from ekfslam.datasets import is_recorded, load_recorded
    from ekfslam.errors import InputError
    from ekfslam.experiments.sources import open_dataset

    if is_recorded(str(source)):
        return load_recorded(str(source), path, **options)
    if options:
        raise InputError(
            f"options {', '.join(options)} are for recorded datasets, not for {source}"
        )
    return open_dataset(source, path=path)


def estimate(dataset: Dataset, estimator: str | Any = "ekf", **options: Any) -> Estimate:
    """Run one estimator on a dataset.

    Parameters
    ----------
    dataset : Dataset
    estimator : str or object
        A registered name, ``module:Class``, either with options as in
        ``ekf(association=joint, confirm=3)``, or an object with ``estimate(dataset)``.
    **options
        For the class that the name stands for, such as ``update="sequential"``.

    Raises
    ------
    UnknownNameError, InputError
        For an unknown estimator or option.
    """
    from ekfslam.dataset import Dataset
    from ekfslam.errors import InputError
    from ekfslam.registry import resolve

    if not isinstance(dataset, Dataset):
        raise InputError(f"estimate takes a Dataset, such as simulate('park'), got {dataset!r}")
    return resolve(estimator, **options).estimate(dataset)
