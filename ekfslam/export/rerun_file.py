"""Runs as recordings of the viewer Rerun; its package is imported when it is asked for."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate
from ekfslam.geometry import Array
from ekfslam.moments import sight_lines
from ekfslam.storage import atomic_write

SIGMAS = 3.0
TRUTH = "#000000"

_FAR = 100.0  # length of a bearing without limit [m]


def load_rerun() -> Any:
    """The package rerun.

    Raises
    ------
    InputError
        If it is not installed; says how to.
    """
    try:
        import rerun
    except ImportError:
        raise InputError(
            'a recording for Rerun needs its package: pip install "ekfslam[rerun]"'
        ) from None
    return rerun


def write_rerun(
    dataset: Dataset,
    steps: Sequence[int],
    estimates: Mapping[str, Sequence[Estimate]],
    path: str | Path,
    colors: Mapping[str, str],
) -> None:
    """Write what estimators say of a run, step by step, as a recording for Rerun (``.rrd``).

    On the timelines ``step`` and ``time``: the true and estimated paths so far, the poses with
    their headings, landmarks, 3-sigma ellipses, and what is seen, as lines from each estimator's
    pose. All of it lies in the plane z = 0 of a space with z up, since Rerun's views of a plane
    have their y downwards. Rerun keeps numbers of 32 bits.

    Parameters
    ----------
    dataset : Dataset
    steps : sequence of int
    estimates : dict of sequences of Estimate
        By name, at each of these steps.
    path : path
    colors : dict of str
        Of each estimator, as ``#rrggbb``.

    Raises
    ------
    InputError
        If the package rerun is not installed, or the file cannot be written.
    """
    rerun = load_rerun()
    with atomic_write(path) as stream, tempfile.TemporaryDirectory() as place:
        scratch = Path(place, "run.rrd")
        log = rerun.RecordingStream("ekfslam", recording_id=dataset.name)
        log.save(scratch)
        log.log("world", rerun.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if dataset.true_map is not None:
            _points(rerun, log, ["true landmarks"], dataset.true_map.positions, TRUTH, static=True)
        for index, step in enumerate(steps):
            log.set_time("step", sequence=step)
            log.set_time("time", duration=float(dataset.times[step]))
            truths = [r.truth[: step + 1] for r in dataset.robots if r.truth is not None]
            _lines(rerun, log, ["truth"], [path[:, :2] for path in truths], TRUTH)
            for name, sequence in estimates.items():
                _log(rerun, log, name, dataset, step, sequence[index], colors[name])
        log.flush()
        log.disconnect()
        stream.write(scratch.read_bytes())


def _log(
    rerun: Any, log: Any, name: str, dataset: Dataset, step: int, estimate: Estimate, color: str
) -> None:
    """What one estimator says at one step."""
    trajectory = estimate.final_trajectory
    if trajectory is None:
        return
    count = len(dataset.robots)
    series = [trajectory.of_robot(robot) for robot in range(count)]
    last = np.stack([each.poses[-1] for each in series])
    _lines(rerun, log, [name, "path"], [each.poses[:, :2] for each in series], color)
    heading = np.column_stack([np.cos(last[:, 2]), np.sin(last[:, 2])])
    arrows = rerun.Arrows3D(origins=_flat(last[:, :2]), vectors=_flat(heading), colors=_rgb(color))
    log.log(["world", name, "pose"], arrows)
    known = [each for each in series if each.covariances is not None]
    spread = [each.covariances[-1, :2, :2] for each in known if each.covariances is not None]
    if spread:
        where = np.stack([each.poses[-1, :2] for each in known])
        _ellipses(rerun, log, [name, "pose ellipse"], where, np.stack(spread), color)
    mapped = estimate.landmarks
    if mapped is not None:
        labels = [str(each) for each in mapped.ids.tolist()]
        _points(rerun, log, [name, "landmarks"], mapped.positions, color, labels=labels)
        if mapped.covariances is not None:
            place = [name, "landmark ellipses"]
            _ellipses(rerun, log, place, mapped.positions, mapped.covariances, color)
    _lines(rerun, log, [name, "seen"], sight_lines(dataset, step, last, _FAR), color, thin=True)


def _points(
    rerun: Any, log: Any, place: list[str], points: Array, color: str, **options: Any
) -> None:
    static = options.pop("static", False)
    drawn = rerun.Points3D(_flat(points), colors=_rgb(color), radii=-2.0, **options)
    log.log(["world", *place], drawn, static=static)  # a negative radius is one on the screen


def _lines(
    rerun: Any, log: Any, place: list[str], lines: Sequence[Array], color: str, thin: bool = False
) -> None:
    strips = [_flat(line[np.isfinite(line).all(axis=1)]) for line in lines]
    drawn = rerun.LineStrips3D(strips, colors=_rgb(color), radii=-0.5 if thin else -1.0)
    log.log(["world", *place], drawn)


def _ellipses(
    rerun: Any, log: Any, place: list[str], means: Array, covariances: Array, color: str
) -> None:
    good = np.isfinite(means).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    _lines(rerun, log, place, list(geo.ellipse(means[good], covariances[good], SIGMAS)), color)


def _flat(points: Array) -> Array:
    """Points of the plane (n, 2) in space (n, 3)."""
    return np.column_stack([points, np.zeros(len(points))])


def _rgb(color: str) -> list[int]:
    return [int(color[i : i + 2], 16) for i in (1, 3, 5)]
