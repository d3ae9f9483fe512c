"""What estimators say as a run goes on, step by step, and a film of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import FAILED, SKIPPED, Estimate
from ekfslam.experiments.attempts import Watch, attempt, named
from ekfslam.experiments.sources import open_dataset
from ekfslam.moments import until

SECONDS, FPS, WIDTH = 10.0, 12, 800


def pictured(poses: int, every: int) -> list[int]:
    """Every so many steps of a run, the last one among them, in order."""
    return list(range(poses - 1, 0, -every))[::-1] or [0]


def so_far(
    dataset: Dataset,
    estimators: Iterable[Any],
    steps: Sequence[int],
    watch: Watch | None = None,
) -> dict[str, list[Estimate]]:
    """What estimators say of a run as far as each of some steps.

    Each runs once for each step, on the run up to it: so the answer is right for all of them, also
    for smoothers and for those of a user. The time is that of all these runs, of half the length on
    average. Joint covariances and innovations are not kept.

    Parameters
    ----------
    dataset : Dataset
    estimators : iterable of str or object
        As for `compare`.
    steps : sequence of int
        Increasing.
    watch : callable, optional
        Told of progress.

    Returns
    -------
    dict of list of Estimate
        By name, in the order of the steps. One that fails or does not apply says so in all of them.

    Raises
    ------
    UnknownNameError, InputError
        For an estimator that there is not.
    """
    found = {}
    for name, subject in named(estimators).items():
        last: Estimate | None = None
        heard: list[Estimate] = []
        for done, step in enumerate(reversed(steps)):
            if watch is not None:
                watch(dataset.name, name, done, len(steps))
            if last is None or last.status not in (FAILED, SKIPPED):
                last = _light(attempt(name, subject, until(dataset, step), _nothing))
            heard.append(last)
        found[name] = heard[::-1]
    return found


def _nothing(dataset: Dataset, estimate: Estimate) -> None:
    """No tables are made."""


def _light(estimate: Estimate) -> Estimate:
    """Without what grows with the square of the map, or is of single observations."""
    mapped = estimate.landmarks
    return replace(
        estimate,
        landmarks=None if mapped is None else replace(mapped, covariance=None),
        joint_covariance=None,
        innovations=None,
    )


def say_who_is_missing(
    final: Iterable[Estimate], tell: Callable[[str], None] | None = None
) -> None:
    """Say which estimators say nothing of a run, and why.

    Parameters
    ----------
    final : iterable of Estimate
    tell : callable, optional
        Called with a line for each of them.

    Raises
    ------
    InputError
        If none says anything.
    """
    final = list(final)
    missing = [f"{e.estimator} {e.status}: {e.message}" for e in final if not e.series]
    if len(missing) == len(final):
        raise InputError("; ".join(missing) or "no estimators")
    if tell is not None:
        for words in missing:
            tell(words)


def animate(
    dataset: str | Dataset,
    estimators: str | Any | Sequence[str | Any] = "ekf",
    path: str | Path = "run.gif",
    seed: int = 0,
    data: str | Path | None = None,
    every: int | None = None,
    seconds: float | None = None,
    fps: int = FPS,
    width: int = WIDTH,
    watch: Watch | None = None,
    tell: Callable[[str], None] | None = None,
) -> Path:
    """Write a film of a run: paths, ellipses and measurements as they come.

    Each picture is what the estimators say of the run as far as its step, see `so_far`.

    Parameters
    ----------
    dataset : str or Dataset
        As for `compare`.
    estimators : str, object or a sequence of them
        As for `compare`. The measurements are drawn from the poses of the first one.
    path : path
        Ends in ``.gif``, which always works, or ``.mp4``, which needs the program ffmpeg.
    seed : int
        Of a simulated dataset.
    data : path, optional
        Where the files of a recorded set lie.
    every : int, optional
        A picture every so many steps.
    seconds : float, optional
        Length of the film, instead of `every`; 10 by default.
    fps : int
        Pictures a second.
    width : int
        In pixels.
    watch : callable, optional
        Told of progress.
    tell : callable, optional
        Told, in a line each, of estimators that say nothing of the run, and why.

    Returns
    -------
    Path

    Raises
    ------
    UnknownNameError, InputError, FileFormatError
        For anything that cannot be found, read or written, before anything runs; and for a run of
        which no estimator says anything.
    """
    from ekfslam.plots.animation import Film, check_film, save_film

    check_film(path, fps, width)
    if every is not None and seconds is not None:
        raise InputError("say either every so many steps, or for how many seconds")
    if every is not None and every < 1:
        raise InputError(f"every must be a number of steps from 1 on, got {every}")
    length = SECONDS if seconds is None else float(seconds)
    if not 0 < length * fps < np.inf:
        raise InputError(f"seconds must be a positive length of the film, got {seconds}")
    subjects = [estimators] if isinstance(estimators, str) else estimators
    subjects = subjects if isinstance(subjects, Iterable) else [subjects]
    opened = open_dataset(dataset, seed=seed, path=data)
    steps = pictured(opened.poses, every or max(1, round(opened.poses / (length * fps))))
    film = Film(opened, steps, so_far(opened, subjects, steps, watch))
    say_who_is_missing((estimates[-1] for estimates in film.estimates.values()), tell)

    def pass_on(done: int, total: int) -> None:
        if watch is not None:
            watch(opened.name, "pictures", done, total)

    return save_film(film, path, fps, width, pass_on)
