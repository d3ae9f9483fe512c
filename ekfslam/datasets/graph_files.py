"""Graph files with 2-D poses and landmarks: ``.g2o``, ``.graph``, ``.pyfg``, ``.txt``.

=========  ===================================================  ==============  ===============
File       Lines                                                Noise           Frame of a
                                                                                motion's noise
=========  ===================================================  ==============  ===============
.g2o       VERTEX_SE2, VERTEX_XY, FIX, EDGE_PRIOR_SE2,          information     second pose
           EDGE_SE2, EDGE_SE2_XY, EDGE_BEARING_SE2_XY,
           EDGE_RANGE_SE2_XY, LANDMARK2;
           PARAMS_SE2OFFSET, EDGE_SE2_POINTXY_OFFSET
.graph     VERTEX2, EDGE2, LANDMARK, BR, EQUIV                  information     second pose
.pyfg      VERTEX_SE2, VERTEX_XY, VERTEX_SE2:PRIOR,             covariance      second pose
           VERTEX_XY:PRIOR, EDGE_SE2, EDGE_SE2_XY, EDGE_RANGE,
           EDGE_BEARING
.txt       EDGE2, ODOMETRY, LANDMARK                            square root of  first pose
                                                                information
=========  ===================================================  ==============  ===============

Matrices are upper triangles row by row, but for those of EDGE2 in ``.graph``, which are in the
order 11, 12, 22, 33, 13, 23 (``inf_ff inf_fs inf_ss inf_rr inf_fr inf_sr`` on the page of TORO,
openslam.org/toro). The same page calls the first id of EDGE2 the observed pose; the files that
there are (w100.graph, as gtsam reads it, too) have the second pose in the frame of the first, and
so it is read. What the six numbers are is no more certain: gtsam takes those of a ``.graph`` for a
covariance by default, and some files were given other tags without other numbers, such as
cityTrees_reduced_1k.g2o of gtsam, which has square roots. ``noise`` says so.

Frames: g2o's and gtsam's error is ``measured^-1 actual``, in the frame of the second pose; TORO
turns the information by the measured rotation, which is the same; iSAM subtracts the measurement
from the actual increment, in the frame of the first.

``.g2o`` and ``.graph`` number poses and landmarks in one space, but for the landmarks of LANDMARK2
and LANDMARK; ``.txt`` in two. In ``.pyfg`` (PyFactorGraph) poses are a letter of the robot and a
number, landmarks L and a number, and vertices, motions and sightings have times, which are those
of the dataset if they are not all the same; PyFactorGraph writes true values as vertices, so
``truth=True`` is for its files. All other values of vertices are what an optimiser is to start
from, and are not used, but for that of the first pose.

What `ekfslam.export.write_g2o` writes loads back: all robots; sightings as x and y in the body
frame, of one sensor, or of several where a landmark is seen more than once from a pose; landmarks
numbered as the vertices are; times as steps. A robot that stands still may see the same twice to
the last digit, so that ``.g2o`` may have such lines, which are counted; in the others they are
damage.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ekfslam.dataset import Dataset
from ekfslam.datasets.graph_parts import (
    NO_PRIORS,
    NO_VERTICES,
    ROBOT,
    Edges,
    Graph,
    Seen,
    Vertices,
    repeated,
    some,
)
from ekfslam.datasets.graph_records import NOISES, VAGUEST, Rows, Tag, read, triangle, whole_number
from ekfslam.datasets.pose_graph import dataset_of
from ekfslam.errors import FileFormatError, InputError

ENDS = ("i", "j")
POSE = ("x", "y", "theta")
TORO_ORDER = (0, 1, 4, 2, 5, 3)  # where 11, 12, 13, 22, 23, 33 stand
SIX, THREE = triangle(("x", "y", "t")), triangle(("x", "y"))
MOTION, POINT = Tag(ENDS, POSE, SIX), Tag(ENDS, ("x", "y"), THREE)
SOLID = re.compile(r"SE3|XYZ|VERTEX3|EDGE3|LANDMARK3|SIM3")


class Format(NamedTuple):
    """How a kind of file says what a graph is made of: tags by role.

    Attributes
    ----------
    tags : mapping of Tag
    motions : tuple of str
        Tags of that role.
    poses, landmarks, fixed, priors : str
        The tag of that role; empty if there is none.
    sightings : mapping of str
        Kind of the sensor by tag.
    noise : str
        What the numbers of a noise are, unless said otherwise.
    frame : str
        Of the noise of a motion.
    order : tuple of int
        Where the triangle of a motion's noise stands.
    beyond : mapping of str
        What a dataset has no place for, by tag.
    letters : bool
        Whether ids are a letter and a number.
    repeats : bool
        Whether a landmark may be seen twice from a pose with the same values.
    """

    tags: Mapping[str, Tag]
    motions: tuple[str, ...]
    sightings: Mapping[str, str]
    noise: str
    frame: str = "second"
    poses: str = ""
    landmarks: str = ""
    fixed: str = ""
    priors: str = ""
    order: tuple[int, ...] = ()
    beyond: Mapping[str, str] = {}
    letters: bool = False
    repeats: bool = False


def _timed(tags: Mapping[str, Tag]) -> dict[str, Tag]:
    return {name: tag._replace(timed=True) for name, tag in tags.items()}


G2O = Format(
    tags={
        "VERTEX_SE2": Tag(("id",), POSE),
        "VERTEX_XY": Tag(("id",), ("x", "y")),
        "FIX": Tag(("id",), many=True),
        "PARAMS_SE2OFFSET": Tag(("id",), POSE),
        "EDGE_PRIOR_SE2": Tag(("id",), POSE, SIX),
        "EDGE_SE2": MOTION,
        "EDGE_SE2_XY": POINT,
        "LANDMARK2": POINT,
        "EDGE_BEARING_SE2_XY": Tag(ENDS, ("bearing",), ("information",)),
        "EDGE_RANGE_SE2_XY": Tag(ENDS, ("range",), ("information",)),
        "EDGE_SE2_POINTXY_OFFSET": Tag((*ENDS, "offset"), ("x", "y"), THREE),
    },
    poses="VERTEX_SE2",
    landmarks="VERTEX_XY",
    fixed="FIX",
    priors="EDGE_PRIOR_SE2",
    motions=("EDGE_SE2",),
    sightings={
        "EDGE_SE2_XY": "xy",
        "LANDMARK2": "xy",
        "EDGE_BEARING_SE2_XY": "bearing",
        "EDGE_RANGE_SE2_XY": "range",
        "EDGE_SE2_POINTXY_OFFSET": "xy",
    },
    noise="information",
    repeats=True,
)
TORO = Format(
    tags={
        "VERTEX2": Tag(("id",), POSE),
        "EDGE2": MOTION._replace(noise=("xx", "xy", "yy", "tt", "xt", "yt")),
        "LANDMARK": POINT,
        "BR": Tag(ENDS, ("bearing", "range"), ("bearing sigma", "range sigma")),
        "EQUIV": Tag(ENDS),
    },
    poses="VERTEX2",
    motions=("EDGE2",),
    sightings={"LANDMARK": "xy", "BR": "range-bearing"},
    noise="information",
    order=TORO_ORDER,
    beyond={"EQUIV": "poses that are one"},
)
PYFG = Format(
    tags={
        "VERTEX_XY": Tag(("id",), ("x", "y")),
        **_timed(
            {
                "VERTEX_SE2": Tag(("id",), POSE),
                "VERTEX_SE2:PRIOR": Tag(("id",), POSE, SIX),
                "VERTEX_XY:PRIOR": Tag(("id",), ("x", "y"), THREE),
                "EDGE_SE2": MOTION,
                "EDGE_SE2_XY": POINT,
                "EDGE_RANGE": Tag(ENDS, ("range",), ("variance",)),
                "EDGE_BEARING": Tag(ENDS, ("bearing",), ("variance",)),
            }
        ),
    },
    poses="VERTEX_SE2",
    landmarks="VERTEX_XY",
    priors="VERTEX_SE2:PRIOR",
    motions=("EDGE_SE2",),
    sightings={"EDGE_SE2_XY": "xy", "EDGE_RANGE": "range", "EDGE_BEARING": "bearing"},
    noise="covariance",
    beyond={"VERTEX_XY:PRIOR": "a prior of a landmark"},
    letters=True,
)
ISAM = Format(
    tags={"EDGE2": MOTION, "ODOMETRY": MOTION, "LANDMARK": POINT},
    motions=("EDGE2", "ODOMETRY"),
    sightings={"LANDMARK": "xy"},
    noise="square-root",
    frame="first",
)
FORMATS = {".g2o": G2O, ".graph": TORO, ".pyfg": PYFG, ".txt": ISAM}
SUFFIXES = (".g2o", ".graph", ".pyfg")  # those that are taken for a graph by their name alone


def load(
    path: str | Path,
    noise: str | None = None,
    unsupported: str = "refuse",
    truth: bool = False,
) -> Dataset:
    """Read a graph file.

    Parameters
    ----------
    path : path
        Its suffix says what it is; it may be compressed (``.gz``).
    noise : {"information", "covariance", "square-root"}, optional
        What the numbers of the noise are the upper triangle of; by default what the format says.
    unsupported : {"refuse", "drop"}
        What to do with lines that a dataset has no place for: loop closures, priors of landmarks
        and of poses but the first. How many were dropped is noted.
    truth : bool
        Whether the values of the vertices are the truth.

    Returns
    -------
    Dataset
        Association known; named after the file.

    Raises
    ------
    FileFormatError
        For a file that cannot be read or does not hang together; names file and line.
    InputError
        For an unknown option or suffix.
    """
    path = Path(path)
    name = path.name.removesuffix(".gz")
    suffix = Path(name).suffix
    if suffix not in FORMATS:
        raise InputError(f"{path}: a graph file ends in {', '.join(FORMATS)}")
    if noise is not None and noise not in NOISES:
        raise InputError(f"noise must be one of {', '.join(NOISES)}, got {noise!r}")
    graph = graph_of(path, FORMATS[suffix], noise)
    return dataset_of(graph, Path(name).stem, unsupported=unsupported, truth=truth, provenance=name)


def graph_of(path: Path, how: Format, noise: str | None = None) -> Graph:
    """What a file of some format holds.

    Parameters
    ----------
    path : Path
    how : Format
    noise : str, optional
        As of `load`.

    Raises
    ------
    FileFormatError
    """
    rows = read(path, how.tags, _unknown, _lettered if how.letters else whole_number)
    noise = noise or how.noise
    poses, landmarks, fixed = (
        _vertices(rows.get(tag)) for tag in (how.poses, how.landmarks, how.fixed)
    )
    _check_unique(path, poses, landmarks, how)
    beyond = [(line, what) for tag, what in how.beyond.items() for line in rows[tag].line.tolist()]
    sightings = []
    for tag, kind in how.sightings.items():
        for seen in _seen(rows[tag], kind, noise, rows.get("PARAMS_SE2OFFSET")):
            of_poses = (seen.edges.end >= ROBOT) & how.letters
            beyond += [
                (line, "a sighting of a pose") for line in seen.edges.line[of_poses].tolist()
            ]
            sightings.append(seen._replace(edges=some(seen.edges, ~of_poses)))
    return Graph(
        path=path,
        motions=_joined([_edges(rows[tag], noise, order=how.order) for tag in how.motions]),
        sightings=[s for s in sightings if len(s.edges.line)] or sightings[:1],
        frame=how.frame,
        poses=poses,
        landmarks=landmarks,
        fixed=fixed,
        priors=_edges(rows[how.priors], noise) if how.priors else NO_PRIORS,
        beyond=beyond,
        named=_letter_and_number if how.letters else str,
        repeats=how.repeats,
    )


def _unknown(tag: str) -> str | None:
    return "this is a graph in 3-D, and datasets are planar" if SOLID.search(tag) else None


def _lettered(word: str) -> int:
    """Ids of PyFactorGraph: landmarks L and a number; poses a letter of the robot and a number."""
    letter, number = word[:1], word[1:]
    if not (letter.isascii() and letter.isalpha() and len(number) <= 9):
        raise ValueError("a letter and a number")
    try:
        return whole_number(number) + ROBOT * (0 if letter == "L" else ord(letter))
    except ValueError:
        raise ValueError("a letter and a number") from None


def _letter_and_number(one: int) -> str:
    return f"{chr(one // ROBOT) if one >= ROBOT else 'L'}{one % ROBOT}"


def _edges(rows: Rows, noise: str, definite: bool = False, order: tuple[int, ...] = ()) -> Edges:
    """Measurements; those of one thing have it on both ends."""
    return Edges(
        rows.line,
        rows.ids[:, 0],
        rows.ids[:, min(1, rows.ids.shape[1] - 1)],
        rows.values,
        rows.covariances(noise, definite, order),
        None if np.isnan(rows.time).any() else rows.time,
    )


def _joined(edges: list[Edges]) -> Edges:
    """Those of several tags, in the order of the file, without their times."""
    columns = [np.concatenate(column) for column in zip(*(e[:5] for e in edges), strict=True)]
    line, start, end, values, covariances = columns
    return some(Edges(line, start, end, values, covariances), np.argsort(line))


def _seen(rows: Rows, kind: str, noise: str, offsets: Rows | None) -> list[Seen]:
    """Sightings of a tag, by sensor where it has several."""
    if kind == "range-bearing":  # written the other way round, with standard deviations
        sigmas, values = rows.noise[:, ::-1], rows.values[:, ::-1]
        fair = (sigmas > 0) & (sigmas <= VAGUEST)
        rows.refuse(~np.all(fair, axis=1), "a sigma that is none")
        spread = np.eye(2) * sigmas[:, None] ** 2
        edges = Edges(rows.line, rows.ids[:, 0], rows.ids[:, 1], values, spread)
        return [Seen(kind, edges, name=kind)]
    edges = _edges(rows, noise, definite=True)
    if rows.ids.shape[1] == 2:
        return [Seen(kind, edges, name=kind)]
    assert offsets is not None
    mounts = dict(zip(offsets.ids[:, 0].tolist(), offsets.values.tolist(), strict=True))
    offsets.refuse(repeated(offsets.ids), "an offset that is there already")
    which = rows.ids[:, 2]
    rows.refuse(~np.isin(which, list(mounts)), "an offset of which there are no PARAMS_SE2OFFSET")
    return [
        Seen(kind, some(edges, which == one), tuple(mounts[one]), f"offset-{one}")
        for one in np.unique(which).tolist()
    ]


def _vertices(rows: Rows | None) -> Vertices:
    if rows is None or not len(rows.line):
        return NO_VERTICES
    time = None if np.isnan(rows.time).any() else rows.time
    return Vertices(rows.line, rows.ids[:, 0], rows.values, time)


def _check_unique(path: Path, poses: Vertices, landmarks: Vertices, how: Format) -> None:
    """A vertex is there once, and is one thing."""
    line = np.concatenate([poses.line, landmarks.line])
    ids = np.concatenate([poses.ids, landmarks.ids])
    order = np.argsort(line)
    for row in order[repeated(ids[order])][:1].tolist():
        one = _letter_and_number(int(ids[row])) if how.letters else str(ids[row])
        raise FileFormatError(f"{path}, line {line[row]}: vertex {one} is there already")
