"""Estimators by name, each tried on a dataset: what fails is a record that says why."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from inspect import signature
from typing import Any

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError, UnsupportedError, blamed, in_words
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.evaluation import judged
from ekfslam.registry import Estimator, estimator_name, resolve

logger = logging.getLogger(__name__)

Watch = Callable[[str, str, int, int], None]
"""Called with (dataset, estimator, steps done, steps in all) on long work."""


class Stopped(KeyboardInterrupt):
    """Work that was interrupted, with what had been found by then.

    Attributes
    ----------
    found : Comparison or AssociationStudy
    done, total : int
        How many estimates, or draws, were made of how many.
    """

    def __init__(self, found: Any, done: int, total: int) -> None:
        super().__init__(f"{done} of {total} were done; what they say is in .found")
        self.found, self.done, self.total = found, done, total


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

    begin = time.perf_counter()
    try:
        with blamed(subject):
            estimate = _call(subject, dataset, progress)
        if not isinstance(estimate, Estimate):
            raise TypeError(f"estimate(dataset) returned {type(estimate).__name__}, not Estimate")
        titled = replace(estimate, estimator=name, dataset=dataset.name)
        estimate = judged(dataset, titled, alignment)
        tabulate(dataset, estimate)  # what cannot be tabulated is no estimate
        seconds = time.perf_counter() - begin
        logger.info("%s: %s: %s after %.3g s", dataset.name, name, estimate.status, seconds)
        return estimate
    except UnsupportedError as reason:
        logger.info("%s: %s: skipped: %s", dataset.name, name, reason)
        return Estimate(name, dataset.name, status=SKIPPED, message=str(reason))
    except (Exception, SystemExit) as error:  # which would take a campaign with it
        message, trace = in_words(error), logger.isEnabledFor(logging.DEBUG)
        logger.warning("%s: %s: failed: %s", dataset.name, name, message, exc_info=trace)
        return Estimate(name, dataset.name, status=FAILED, message=message)


def _call(subject: Estimator, dataset: Dataset, progress: Any) -> Any:
    """Estimate, with progress if the estimator tells of it."""
    if progress is not None and "progress" in signature(subject.estimate).parameters:
        return subject.estimate(dataset, progress=progress)  # type: ignore[call-arg]
    return subject.estimate(dataset)
