"""Estimators by name, each tried on a dataset: what fails is a record that says why."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from inspect import signature
from typing import Any

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnsupportedError, blamed, in_words
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import judged
from ekfslam.registry import Estimator, estimator_name, resolve

Watch = Callable[[str, str, int, int], None]
"""Called with (dataset, estimator, steps done, steps in all) on long work."""


def named(estimators: Iterable[Any]) -> dict[str, Estimator]:
    """Estimators under distinct names.

    Raises
    ------
    UnknownNameError, InputError
        As `ekfslam.registry.resolve`, and for two of the same name.
    """
    subjects: dict[str, Estimator] = {}
    for estimator in estimators:
        name = estimator_name(estimator)
        if name in subjects:
            raise InputError(f"two estimators are called {name}; give one another `name`")
        subjects[name] = resolve(estimator)
    return subjects


def attempt(
    name: str,
    subject: Estimator,
    dataset: Dataset,
    tabulate: Callable[[Dataset, Estimate], Any],
    alignment: str = "none",
    watch: Watch | None = None,
) -> Estimate:
    """The estimate with its status, or a record that says why there is none.

    Parameters
    ----------
    name : str
        What the estimate is called.
    subject : Estimator
    dataset : Dataset
    tabulate : callable
        Given dataset and estimate; what it raises makes the estimate a failed one.
    alignment : {"none", "se2"}
        Applied before an estimate is judged.
    watch : callable, optional
    """
    progress = None
    if watch is not None:
        watch(dataset.name, name, 0, dataset.poses)

        def progress(done: int, total: int) -> None:
            watch(dataset.name, name, done, total)

    try:
        with blamed(subject):
            estimate = _call(subject, dataset, progress)
        if not isinstance(estimate, Estimate):
            raise TypeError(f"estimate(dataset) returned {type(estimate).__name__}, not Estimate")
        titled = replace(estimate, estimator=name, dataset=dataset.name)
        estimate = judged(dataset, titled, alignment)
        tabulate(dataset, estimate)  # what cannot be tabulated is no estimate
        return estimate
    except UnsupportedError as reason:
        return Estimate(name, dataset.name, status=SKIPPED, message=str(reason))
    except (Exception, SystemExit) as error:  # which would take a campaign with it
        return Estimate(name, dataset.name, status=FAILED, message=in_words(error))


def _call(subject: Estimator, dataset: Dataset, progress: Any) -> Any:
    """Estimate, with progress if the estimator tells of it."""
    if progress is not None and "progress" in signature(subject.estimate).parameters:
        return subject.estimate(dataset, progress=progress)  # type: ignore[call-arg]
    return subject.estimate(dataset)
