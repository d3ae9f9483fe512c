"""The study of recorded sets: all of them, with all estimators, those that cannot apply as rows."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from ekfslam.dataset import Dataset
from ekfslam.datasets import RECORDED
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import Estimate
from ekfslam.evaluation import tables
from ekfslam.experiments.attempts import Watch
from ekfslam.experiments.compare import compare
from ekfslam.experiments.comparison import Comparison
from ekfslam.experiments.files import check_folder, versions, write_together
from ekfslam.experiments.study import mapped
from ekfslam.registry import resolve

FILTERS = ("ekf", "iekf", "ekf-ideal", "ekf-fej", "ekf-oc", "ekf-ri", "ekf-robocentric")
SMOOTHERS = ("gtsam-batch", "gtsam-isam2", "gtsam-fixed-lag")
PARTICLES = ("fastslam1", "fastslam2")
ON_KNOWN_MAP = ("ekf-localization", "gtsam-localization")
ESTIMATORS = (*FILTERS, *SMOOTHERS, *PARTICLES, *ON_KNOWN_MAP, "dead-reckoning")
EVERY = 50  # steps between covariances of the newest pose: gtsam takes long for each

KEPT = ("summary", "landmarks", "association")  # the others are large
SHOWN = ("ekf", "ekf-ri", "gtsam-batch", "ekf-localization", "dead-reckoning")
ALIGNED = ("ate_position_rmse_m", "landmark_rmse_m", "landmark_max_m")


class Case(NamedTuple):
    """A recorded set and what the estimators are told with it.

    Attributes
    ----------
    dataset : str
    association : str
        Options of the filters where identities are not known; the smoothers take the EKF's.
    options : str
        Of the dataset.
    """

    dataset: str
    association: str = ""
    options: str = ""

    @property
    def source(self) -> str:
        """How the dataset is asked for."""
        return f"{self.dataset}({self.options})" if self.options else self.dataset


CASES: tuple[Case, ...] = (
    Case("victoria-park"),
    Case("victoria-park-raw", "association=nearest, confirm=3, within=8"),
    Case("plaza1"),
    Case("plaza2"),
    *(Case(f"mrclam{number}/robot{robot}") for number in (1, 2) for robot in range(1, 6)),
    # Of a team every step has five poses, all of which hang together.
    *(Case(f"mrclam{number}", options="step=1") for number in (1, 2)),
    Case("lego", "association=nearest"),
    Case("car-park", "association=nearest, confirm=3"),
    Case("dlr"),
    Case("city-trees"),
    Case("freiburg-course"),
)
"""All sets that were to hand when the tables of the documentation were made."""


@dataclass(frozen=True, eq=False)
class RecordedStudy:
    """What the study found.

    Attributes
    ----------
    summary : DataFrame
        The table of that name of each comparison, as estimated, with the errors after SE(2)
        alignment with the truth in columns ``aligned_...``.
    notes : dict of tuple of str
        What there is to know of each set.
    missing : dict of str
        Sets whose files are not here, and where to get them.
    config : dict
    """

    summary: pd.DataFrame
    notes: Mapping[str, tuple[str, ...]]
    missing: Mapping[str, str]
    config: dict[str, Any]


class _Titled:
    """An estimator under its plain name: what its options are is in the configuration."""

    def __init__(self, name: str, text: str) -> None:
        self.name, self.subject = name, resolve(text)

    def warm_up(self, dataset: Dataset) -> None:
        """Compile."""
        if hasattr(self.subject, "warm_up"):
            self.subject.warm_up(dataset)

    def estimate(self, dataset: Dataset, progress: Any = None) -> Estimate:
        """Estimate."""
        if "progress" in signature(self.subject.estimate).parameters:
            return self.subject.estimate(dataset, progress=progress)  # type: ignore[call-arg]
        return self.subject.estimate(dataset)


def texts_of(case: Case) -> dict[str, str]:
    """How each estimator is asked for on a set, with options, by name."""
    own = f"({case.association})" if case.association else ""
    texts = {name: f"{name}{own}" for name in FILTERS}
    for name in SMOOTHERS:
        batch = name == "gtsam-batch"
        taken = f"{'initial' if batch else 'association'}=ekf{own}" if own else ""
        options = ", ".join(filter(None, (taken, "" if batch else f"marginal_every={EVERY}")))
        texts[name] = f"{name}({options})" if options else name
    # A filter that is started with tentative landmarks has no robocentric form.
    if "confirm" in case.association:
        words = case.association.split(", ")
        plain = ", ".join(w for w in words if not w.startswith(("confirm", "within")))
        texts["ekf-robocentric"] = f"ekf-robocentric({plain})"
    others = (*PARTICLES, *ON_KNOWN_MAP, "dead-reckoning")
    return texts | {name: name for name in others}


def recorded_study(
    out: str | Path,
    datasets: Sequence[str] | None = None,
    estimators: Sequence[str] = ESTIMATORS,
    path: str | Path | None = None,
    workers: int = 1,
    watch: Watch | None = None,
) -> RecordedStudy:
    """Run all estimators on all recorded sets that are here.

    Parameters
    ----------
    out : path
        Folder for ``summary.csv`` and ``config.json``, and a folder in it for each set, with the
        tables and figures of its comparison.
    datasets : sequence of str, optional
        Some of `CASES`; by default all that are here.
    estimators : sequence of str
        Some of `ESTIMATORS`.
    path : path, optional
        Folder of the sets; by default that of the environment variable EKFSLAM_DATA.
    workers : int
        Processes; the outcome is the same.
    watch : callable, optional
        Told of progress: (set, "", sets done, sets in all).

    Returns
    -------
    RecordedStudy

    Raises
    ------
    UnknownNameError
        For a set or an estimator that is not among those.
    InputError
        If no set is here, or the folder cannot be written to.
    FileFormatError
        For a damaged file, or a set that was asked for and is not here.
    """
    known = {case.dataset: case for case in CASES}
    for name in datasets or ():
        if name not in known:
            raise UnknownNameError("recorded set of the study", name, known)
    for name in estimators:
        if name not in ESTIMATORS:
            raise UnknownNameError("estimator of the study", name, ESTIMATORS)
    wanted = [known[name] for name in datasets] if datasets else list(CASES)
    why = {} if datasets else {case.dataset: _missing(case.dataset, path) for case in wanted}
    missing = {name: text for name, text in why.items() if text}
    here = [case for case in wanted if case.dataset not in missing]
    if not here:
        raise InputError("no recorded set is here: give the folder of the sets (--data PATH)")
    check_folder(out, "study recorded")
    task = partial(_run, tuple(estimators), path, Path(out))
    found = []
    with mapped(workers, task, here) as results:
        for case, part in zip(here, results, strict=True):
            found.append(part)
            if watch is not None:
                watch(case.dataset, "", len(found), len(here))
    rows, notes = [part[0] for part in found], dict(part[1] for part in found)
    told = {case.source: _asked(case, estimators) for case in here}
    summary = pd.concat(rows, ignore_index=True)
    config = {"study": "recorded", "estimators": told, "missing": missing, "versions": versions()}

    def write(folder: Path) -> None:
        summary.to_csv(folder / "summary.csv", index=False)
        (folder / "config.json").write_text(json.dumps(config, indent=2) + "\n")

    write_together(out, write)
    return RecordedStudy(summary, notes, missing, config)


def _asked(case: Case, estimators: Sequence[str]) -> dict[str, str]:
    return {name: text for name, text in texts_of(case).items() if name in estimators}


def _run(
    estimators: tuple[str, ...], path: str | Path | None, out: Path, case: Case
) -> tuple[pd.DataFrame, tuple[str, tuple[str, ...]]]:
    """A set with its estimators: its folder, rows of the summary, name and notes."""
    subjects = [_Titled(name, text) for name, text in _asked(case, estimators).items()]
    found = compare([case.source], subjects, path=path)
    folder = out / case.dataset.replace("/", "-")
    found.save(folder, figures=False, kept=KEPT)
    _shown(found).save(folder, kept=())
    ((name, dataset),) = found.datasets.items()
    return _with_aligned(found), (name, dataset.notes)


def _shown(found: Comparison) -> Comparison:
    """What figures have room for."""
    names = ("trajectories", "landmarks", "innovations")
    some = {name: getattr(found, name) for name in names}
    return replace(found, **{k: rows[rows["estimator"].isin(SHOWN)] for k, rows in some.items()})


def _with_aligned(found: Comparison) -> pd.DataFrame:
    """The summary, and errors after alignment beside those without."""
    aligned = [
        tables.summary_rows(found.datasets[name], estimate, alignment="se2")
        for (name, _), estimate in found.estimates.items()
    ]
    after = pd.concat(aligned, ignore_index=True)
    return found.summary.assign(**{f"aligned_{name}": after[name] for name in ALIGNED})


def _missing(name: str, path: str | Path | None) -> str:
    """Why a set is not here, empty if it is."""
    whole = name.partition("/")[0]
    recorded = RECORDED[whole]
    if recorded.is_here(name, recorded.given(whole, path)):
        return ""
    return "; ".join(f"{key}: {text}" for key, text in recorded.told(whole, path)[-2:])
