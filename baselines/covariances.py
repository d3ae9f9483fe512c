"""Marginal covariances of all poses and landmarks of a graph, at once.

gtsam recovers one variable at a time, and where landmarks are seen from everywhere each of them
takes about as long as an elimination. Here gtsam linearises the graph, and of the inverse of
``J' J``, with J its whitened Jacobian, what is asked for comes out of one sparse factorisation, see
`baselines.selected_inverse`.

A constraint has no finite weight. So what it fixes is not among the unknowns: a start that is known
and a landmark that is held do not move, and the pose of a displaced sensor moves as the robot's
does. All that can move is
then free of constraints, and their rows come to nothing.
"""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.sparse import csc_array, csr_array

from baselines import keys
from baselines.landmark_graph import LandmarkGraph
from baselines.selected_inverse import IndeterminateError, diagonal_blocks
from ekfslam import geometry as geo
from ekfslam.geometry import Array


def warm_up() -> None:
    """Compile what recovers covariances, before any clock starts."""
    diagonal_blocks(csc_array(np.eye(2)), np.array([1, 1]), np.array([0, 1]))


def recovered(
    problem: LandmarkGraph,
    graph: gtsam.NonlinearFactorGraph,
    values: gtsam.Values,
    estimates: Array,
) -> tuple[Array, Array]:
    """Marginal covariances of poses and landmarks.

    Parameters
    ----------
    problem : LandmarkGraph
    graph : gtsam.NonlinearFactorGraph
        Of the problem.
    values : gtsam.Values
        Where it is linearised.
    estimates : (R, K + 1, 3) ndarray
        Poses, whose headings turn covariances into the world.

    Returns
    -------
    (R, K + 1, 3, 3) ndarray, (L, 2, 2) ndarray
        Additive.

    Raises
    ------
    RuntimeError
        If the system is indeterminate, with the key of a variable in the words of gtsam.
    """
    variables = np.array(values.keys(), dtype=np.int64)
    letters = keys.POSE, keys.SENSOR, keys.LANDMARK, keys.HELD
    own, sensor, landmark, held = (keys.has_letter(variables, letter) for letter in letters)
    sizes = np.where(held | (landmark & (not problem.points_3d)), 2, 3)
    known = keys.pose_key(np.zeros(1, dtype=np.int64), np.flatnonzero(problem.known_starts))
    unknown = ~sensor & ~held & ~np.isin(variables, known)
    carrier = np.searchsorted(variables, keys.carrier(variables[sensor]))
    poses = np.zeros((len(variables), 3))
    poses[own | sensor] = gtsam.utilities.extractPose2(values)
    motion = _motion(sizes, unknown, np.flatnonzero(sensor), carrier, poses)
    J = _jacobian(graph.linearize(values), motion.shape[0]) @ motion
    rank = _ranks(graph, variables)
    np.maximum.at(rank, carrier, rank[sensor])
    try:
        found = diagonal_blocks((J.T @ J).tocsc(), sizes[unknown], np.argsort(rank[unknown]))
    except IndeterminateError as error:
        key = variables[unknown][error.variable]
        raise RuntimeError(f"indeterminate system near variable {key}") from None
    blocks = np.zeros((len(variables), 3, 3))
    blocks[unknown, : found.shape[1], : found.shape[2]] = found
    bodies = blocks[own].reshape(*estimates.shape, 3)
    return geo.body_to_additive(estimates, bodies), blocks[landmark, :2, :2]


def _jacobian(linear: gtsam.GaussianFactorGraph, columns: int) -> csr_array:
    """Whitened Jacobian, with columns by the keys of variables; constraints have weight 1."""
    row, column, entry = linear.sparseJacobian_()
    row, column = row.astype(np.int64) - 1, column.astype(np.int64) - 1
    kept = column < columns  # behind them is the right hand side
    shape = int(row.max()) + 1, columns
    return csr_array((entry[kept], (row[kept], column[kept])), shape=shape)


def _motion(
    sizes: np.ndarray, unknown: np.ndarray, sensor: np.ndarray, carrier: np.ndarray, poses: Array
) -> csr_array:
    """How all variables move with the unknown ones: (coordinates, unknown coordinates).

    A pose s of a sensor on a robot x moves as ``Ad(s^-1 x) dx``, in the bodies of both.
    """
    first = np.cumsum(sizes) - sizes
    coordinates = np.flatnonzero(np.repeat(unknown, sizes))
    column = np.full(sizes.sum(), -1)
    column[coordinates] = np.arange(len(coordinates))
    frames = geo.between(poses[sensor], poses[carrier])
    adjoint = geo.heading_block(frames[:, 2])
    adjoint[:, :2, 2] = -geo.perpendicular(frames[:, :2])
    moving = unknown[carrier]
    adjoint, sensor, carrier = adjoint[moving], sensor[moving], carrier[moving]
    rows, columns = np.broadcast_arrays(
        first[sensor, None, None] + np.arange(3)[:, None],
        column[first[carrier], None, None] + np.arange(3),
    )
    entries = np.concatenate([np.ones(len(coordinates)), adjoint.ravel()])
    rows = np.concatenate([coordinates, rows.ravel()])
    columns = np.concatenate([column[coordinates], columns.ravel()])
    return csr_array((entries, (rows, columns)), shape=(len(column), len(coordinates)))


def _ranks(graph: gtsam.NonlinearFactorGraph, variables: np.ndarray) -> np.ndarray:
    """Place of each variable in the order in which gtsam would eliminate them."""
    ordering = graph.orderingCOLAMD()
    order = np.array([ordering.at(i) for i in range(ordering.size())], dtype=np.int64)
    rank = np.empty(len(variables), dtype=np.int64)
    rank[np.searchsorted(variables, order)] = np.arange(len(order))
    return rank
