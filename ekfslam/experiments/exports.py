"""Runs and what estimators say of them, in formats that other programs read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.experiments.attempts import Watch
from ekfslam.experiments.files import stem
from ekfslam.experiments.film import pictured, say_who_is_missing, so_far
from ekfslam.experiments.sources import open_dataset
from ekfslam.export import write_g2o, write_rerun, write_tum
from ekfslam.export.rerun_file import load_rerun

MOMENTS = 100
"""Steps of a recording for Rerun, unless another number is asked for."""


def export(
    dataset: str | Dataset,
    estimators: Iterable[str | Any] = ("ekf",),
    tum: str | Path | None = None,
    g2o: str | Path | None = None,
    rerun: str | Path | None = None,
    every: int | None = None,
    seed: int = 0,
    data: str | Path | None = None,
    watch: Watch | None = None,
    tell: Callable[[str], None] | None = None,
) -> list[Path]:
    """Write a run for other programs.

    Parameters
    ----------
    dataset : str or Dataset
        As for `compare`.
    estimators : iterable of str or object
        As for `compare`; not needed for `g2o` alone.
    tum : path, optional
        Folder for trajectories as TUM text, which evo reads: ``DATASET-ESTIMATOR-SERIES.tum``, and
        ``DATASET-truth.tum`` where the truth is known; of several robots each has its own. Poses
        that are not known are left out.
    g2o : path, optional
        File for the graph of the dataset.
    rerun : path, optional
        File for a recording of the viewer Rerun, which needs its package.
    every : int, optional
        Of the recording: a moment every so many steps, by default what makes 100 moments. Each
        estimator runs once for each, see `ekfslam.experiments.film.so_far`.
    seed : int
        Of a simulated dataset.
    data : path, optional
        Where the files of a recorded set lie.
    watch : callable, optional
        Told of progress.
    tell : callable, optional
        Told, in a line each, of estimators that say nothing of the run, and why.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    UnknownNameError, InputError, FileFormatError, UnsupportedError
        For anything that cannot be found, read, said in a format, or written; and for estimators
        none of which says anything.
    """
    if tum is None and g2o is None and rerun is None:
        raise InputError("nothing to write: say where to by tum, g2o or rerun")
    if every is not None and every < 1:
        raise InputError(f"every must be a number of steps from 1 on, got {every}")
    if rerun is not None:
        load_rerun()
    for path in (g2o, rerun):
        if path is not None and not Path(path).parent.is_dir():
            raise InputError(f"cannot write {path}: there is no folder {Path(path).parent}")
    opened = open_dataset(dataset, seed=seed, path=data)
    written = []
    if g2o is not None:
        write_g2o(opened, g2o)
        written.append(Path(g2o))
    if tum is None and rerun is None:
        return written
    steps = [opened.poses - 1]
    if rerun is not None:
        steps = pictured(opened.poses, every or max(1, opened.poses // MOMENTS))
    found = so_far(opened, estimators, steps, watch)
    final = {name: sequence[-1] for name, sequence in found.items()}
    say_who_is_missing(final.values(), tell)
    if tum is not None:
        written += write_trajectories(opened, list(final.values()), tum)
    if rerun is not None:
        from ekfslam.plots import looks

        colors = {name: own.color for name, own in looks(found).items()}
        write_rerun(opened, steps, found, rerun, colors)
        written.append(Path(rerun))
    return written


def write_trajectories(
    dataset: Dataset, estimates: Sequence[Estimate], folder: str | Path
) -> list[Path]:
    """Write the series of estimates, and the truth where it is known, as TUM text.

    Parameters
    ----------
    dataset : Dataset
    estimates : sequence of Estimate
    folder : path
        Is made if needed.

    Returns
    -------
    list of Path
        The files, see `export`. A truth without headings is none, since a line of TUM has one.

    Raises
    ------
    InputError
        If the folder cannot be written to.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write to {folder}: {error.strerror or error}") from None
    written = []
    for index, robot in enumerate(dataset.robots):
        whose = (robot.name,) if len(dataset.robots) > 1 else ()
        series: dict[tuple[str, ...], Trajectory] = {}
        if robot.truth is not None:
            series["truth",] = Trajectory(robot.truth)
        for estimate in estimates:
            for name, trajectory in estimate.series.items():
                series[estimate.estimator, name] = trajectory.of_robot(index)
        for words, trajectory in series.items():
            known = np.isfinite(trajectory.poses).all(axis=1)
            if known.any():
                path = folder / f"{stem(dataset.name, *words, *whose)}.tum"
                write_tum(Trajectory(trajectory.poses[known]), dataset.times[known], path)
                written.append(path)
    return written
