"""City trees: 10,000 poses in a grid of streets, 100 trees (Kaess, Ranganathan and Dellaert 2008).

Simulated by others, with known association and a noise-free truth: a long run on which the noise
is white, Gaussian, and what the file says. ``cityTrees10000.txt`` is the graph as distributed with
iSAM, ``cityTrees10000_groundtruth.txt`` the same edges without noise, and ``city-trees/mc0`` and so
on are further draws of the noise, from ``cityTrees10000_mc0.txt`` beside them.

The lines are those of iSAM (see `ekfslam.datasets.graph_files`): EDGE2 and LANDMARK with the upper
triangle of the *square root* of the information (1/50 m, 1/50 m, 1/100 rad per step; 1/10 m per
axis), poses and trees numbered in two spaces. The truth starts at the origin, where the first pose
is known, and follows the noise-free edges. Their turns are quarters of a circle printed with six
digits, and are taken as such: as printed, the same tree would be in places 15 mm apart.

Sixteen trees stand in pairs in the same place: whoever is not told the association takes 92 trees
for the truth, and is right.

The files have no times: the time of a pose is its number, in steps.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ekfslam import geometry as geo
from ekfslam.dataset import Dataset
from ekfslam.datasets.catalogue import files_of
from ekfslam.datasets.graph_files import ISAM, graph_of
from ekfslam.datasets.graph_parts import Edges, Graph
from ekfslam.datasets.places import there
from ekfslam.datasets.pose_graph import dataset_of
from ekfslam.errors import FileFormatError
from ekfslam.robots import LandmarkMap

GRAPH, TRUTH = "cityTrees10000.txt", "cityTrees10000_groundtruth.txt"
QUARTER = np.pi / 2
PRINTED = 1e-5  # [rad] that six digits may take off a turn
APART = 1e-3  # [m] that sightings without noise may differ by in the place of a tree


def load(path: str | Path | None = None, part: str = "") -> Dataset:
    """Load city trees.

    Parameters
    ----------
    path : path, optional
        The folder of its files; by default that of the environment variable EKFSLAM_DATA.
    part : str
        A further draw of the noise: ``mc0`` and so on.

    Returns
    -------
    Dataset
        One robot from the origin with its truth, trees as x and y in the frame of the pose,
        association known, and the true map.

    Raises
    ------
    FileFormatError
        For a file that is missing or malformed, or a graph that is not that of the truth; names
        file and line.
    """
    files = files_of("city-trees", path)
    noisy = files[GRAPH]
    if part:
        file = GRAPH.replace(".txt", f"_{part}.txt")
        draw = there(noisy, file)
        if draw is None:
            raise FileFormatError(
                f"city-trees/{part}: {noisy.parent} has no {file} (nor {file}.gz)"
            )
        noisy = draw
    graph, exact = graph_of(noisy, ISAM), graph_of(files[TRUTH], ISAM)
    _check_same(graph, exact)
    dataset = dataset_of(
        graph,
        f"city-trees/{part}" if part else "city-trees",
        provenance=f"{noisy.name}; distributed with iSAM: M. Kaess, A. Ranganathan and "
        "F. Dellaert, IEEE Trans. Robotics 24(6), 2008",
    )
    free = dataset_of(exact, "truth")
    turns = QUARTER * np.round(free.robot.controls[:, 2] / QUARTER)
    moves = free.robot.controls.copy()
    near = np.abs(moves[:, 2] - turns) <= PRINTED
    moves[near, 2] = turns[near]
    truth = geo.integrate(np.zeros(3), moves)
    trees = _true_map(exact, truth)
    return replace(
        dataset,
        robots=(replace(dataset.robot, truth=truth),),
        known_map=trees,
        true_map=trees,
        true_landmark=dataset.observations.landmark,
        notes=dataset.notes[:1],
    )


def _check_same(graph: Graph, exact: Graph) -> None:
    """The truth has the same edges, line by line."""
    for what, ours, theirs in (
        ("motion", graph.motions, exact.motions),
        ("sighting", graph.sightings[0].edges, exact.sightings[0].edges),
    ):
        if len(ours.line) != len(theirs.line):
            raise FileFormatError(
                f"{graph.path}: {len(ours.line)} lines of a {what}, but {exact.path} has "
                f"{len(theirs.line)}"
            )
        for row in np.flatnonzero((ours.start != theirs.start) | (ours.end != theirs.end))[:1]:
            raise FileFormatError(
                f"{graph.path}, line {ours.line[row]}: another {what} than in line "
                f"{theirs.line[row]} of {exact.path}"
            )


def _true_map(exact: Graph, truth: np.ndarray) -> LandmarkMap:
    """Places of the trees, as they are first seen without noise."""
    seen: Edges = exact.sightings[0].edges
    steps = np.unique(np.concatenate([exact.motions.start, exact.motions.end]))
    places = geo.from_frame(truth[np.searchsorted(steps, seen.start)], seen.values)
    trees, first, which = np.unique(seen.end, return_index=True, return_inverse=True)
    off = np.linalg.norm(places - places[first][which], axis=1)
    exact.refuse(
        seen.line,
        off > APART,
        lambda row: f"landmark {seen.end[row]} is {off[row]:.3g} m from where it was first seen",
    )
    return LandmarkMap(trees, places[first])
