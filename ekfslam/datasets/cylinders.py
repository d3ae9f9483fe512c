"""Cylinders in laser scans, found by the derivative of the scan (Brenner's SLAM lectures, unit A).

A thin thing in front of what is far behind it makes the range fall at one side and rise at the
other. Half the difference of the two neighbours of a beam is the derivative there; a cylinder is
what lies between a fall and the next rise, if there is no other edge between them. An edge is two
beams wide in this derivative, so the beams at the sides, which may have hit half of each, are left
out of the means.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ekfslam.checks import checked_array
from ekfslam.datasets.options import positive
from ekfslam.geometry import Array


class Cylinders(NamedTuple):
    """What was found, in the order of scans and beams.

    Attributes
    ----------
    scan : (m,) ndarray of int
        Row of the scans.
    beam : (m,) ndarray
        Mean number of its beams, from 0 on.
    range : (m,) ndarray
        Mean range of its beams: to its surface, in the unit of the scans.
    beams : (m,) ndarray of int
        How many there are.
    """

    scan: np.ndarray
    beam: Array
    range: Array
    beams: np.ndarray


def derivatives(ranges: Array, least: float) -> Array:
    """Half the difference of a beam's two neighbours; 0 where one of them is no return.

    Parameters
    ----------
    ranges : (n, b) ndarray
        Scans.
    least : float
        What is below is no return.

    Returns
    -------
    (n, b) ndarray
        0 in the first and the last beam.
    """
    slopes = np.zeros_like(ranges)
    before, after = ranges[:, :-2], ranges[:, 2:]
    seen = (before >= least) & (after >= least)
    slopes[:, 1:-1] = np.where(seen, 0.5 * (after - before), 0.0)
    return slopes


def find_cylinders(ranges: Any, jump: float, least: float = 0.0) -> Cylinders:
    """Find the cylinders of many scans.

    Parameters
    ----------
    ranges : (n, b) array_like
        One scan a row, beams in the order of their angles; any unit.
    jump : float
        Derivative beyond which there is an edge: half of a step in range, if it is a clean one.
    least : float
        Ranges below are no return: they are in no mean and make no edge.

    Returns
    -------
    Cylinders

    Raises
    ------
    InputError
        For scans that are no matrix of numbers, or a jump that is not positive.
    """
    ranges = checked_array(ranges, float, (None, None), "ranges")
    positive(jump, "jump")
    slopes = derivatives(ranges, least)
    scan, beam = np.nonzero(np.abs(slopes) > jump)
    rising = slopes[scan, beam] > 0
    # Edges that follow each other in one scan, down and then up.
    pairs = np.flatnonzero(~rising[:-1] & rising[1:] & (scan[:-1] == scan[1:]))
    row, first, last = scan[pairs], beam[pairs] + 1, beam[pairs + 1]
    valid = ranges >= least

    def between(values: Array) -> Array:
        """Sums over the valid beams from `first` to before `last`."""
        sums = np.cumsum(np.where(valid, values, 0.0), axis=1)
        return sums[row, last - 1] - sums[row, first - 1]

    count = between(np.ones_like(ranges))
    some = count > 0
    with np.errstate(invalid="ignore"):
        mean_beam = between(np.broadcast_to(np.arange(ranges.shape[1]), ranges.shape)) / count
        mean_range = between(ranges) / count
    return Cylinders(row[some], mean_beam[some], mean_range[some], count[some].astype(np.int64))


def centres(found: Cylinders, offset: float, ahead: float, angle: float) -> Array:
    """Cylinders as a sensor of range and bearing reports their centres.

    Parameters
    ----------
    found : Cylinders
    offset : float
        From the mean range of the beams to the centre, in the unit of the scans.
    ahead : float
        Number of the beam along the scanner's x axis.
    angle : float
        Between neighbouring beams [rad], positive if they are counted counter-clockwise.

    Returns
    -------
    (m, 2) ndarray
        Range, in the unit of the scans, and bearing [rad].
    """
    return np.column_stack([found.range + offset, (found.beam - ahead) * angle])
