"""How figures look, and how they reach the disk: the same everywhere, nothing set globally."""

from __future__ import annotations

import re
import textwrap
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from io import BytesIO
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
from matplotlib.figure import Figure

from ekfslam.plots.vision import apart
from ekfslam.storage import atomic_write

COLUMN = 3.5
"""Width of one column of a paper [in]."""
PAGE = 7.16
"""Width of both columns of a paper [in]."""

TRUTH = "#000000"
QUIET = "#7f7f7f"  # zero lines and intervals

_LABEL = 32  # letters of a line in a legend

_SETTINGS: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # ships with matplotlib: the same on every machine
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "figure.titlesize": 9,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e6e6e6",
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,  # text stays text in vector files
    "ps.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "ekfslam",  # the same file from the same figure
}


class Look(NamedTuple):
    """How an estimator is drawn, in every figure."""

    color: str
    marker: Any
    linestyle: str


# The first colours are those that the colour-blind tell apart of Okabe and Ito (2008); their black
# is for the truth and their yellow too faint on white. The estimators are more than there are such
# colours: the others are placed so that any two are as far apart as so many can be for all eyes,
# and farther where they are compared with one another (`ekfslam.plots.vision`).
_BLUE, _GREEN, _ORANGE = "#0072B2", "#009E73", "#E69F00"
_VERMILLION, _PURPLE, _SKY = "#D55E00", "#CC79A7", "#56B4E9"

LOOKS: Mapping[str, Look] = {
    "ekf": Look(_BLUE, "o", "-"),
    "ekf-compressed": Look("#004E99", "8", ":"),
    "iekf": Look(_SKY, "h", "--"),
    "ekf-ideal": Look("#6A6D79", "*", ":"),
    "ekf-fej": Look("#EE99A3", "v", "-."),
    "ekf-oc": Look("#7C1245", "D", "--"),
    "ekf-ri": Look(_VERMILLION, "P", "-"),
    "ekf-robocentric": Look("#6C7B3E", "X", ":"),
    "gtsam-batch": Look(_GREEN, "s", "--"),
    "gtsam-isam2": Look(_ORANGE, "^", "-."),
    "gtsam-fixed-lag": Look("#301C88", "<", "-."),
    "fastslam1": Look("#1785FF", ">", "--"),
    "fastslam2": Look("#661100", "d", "-"),
    "ekf-localization": Look("#943740", "p", "-"),
    "gtsam-localization": Look("#5944BE", "H", "--"),
    "dead-reckoning": Look("#8D98B4", "x", ":"),
}
"""Estimators that come with the package."""

METHODS: Mapping[str, Look] = {
    "known": Look(_BLUE, "o", "-"),
    "joint": Look(_GREEN, "s", "-"),
    "nearest": Look(_VERMILLION, "v", "--"),
    "global": Look(_PURPLE, "D", "-."),
    "maximum-likelihood": Look(_ORANGE, "^", "--"),
    "smallest-distance": Look(_ORANGE, "<", ":"),
    "euclidean": Look(_SKY, "P", "-."),
    "euclidean-first": Look(_SKY, "X", ":"),
    "mahalanobis-first": Look("#999999", "x", ":"),
}
"""The EKF by method of association, as in ``ekf-joint`` or ``ekf(association=joint, confirm=3)``;
a method that is a form of another one shares its colour."""

# For estimators of others, and for ours with options: markers that none of ours has.
_FORMS = (((4, 1, 0), "-"), ((3, 1, 0), "--"), ((8, 1, 0), "-."), ((4, 1, 45), ":"))


def _formed(colors: Iterable[str]) -> tuple[Look, ...]:
    return tuple(Look(color, *form) for form, color in product(_FORMS, colors))


_OTHERS = _formed(["#E105FB", "#9CA45A", "#9D2B15", "#6C1923"])  # which none of ours has, either
_SPARE = _formed(own.color for own in LOOKS.values())  # where many of them, and few of ours, meet
_CLOSE = 18.0  # distance of colours below which another is looked for


# Options that say how much is computed, not how.
_SAME = re.compile(r"(marginals|marginal_every|seed|delay|threads|area)=[^,()]*(, )?")
_METHOD = re.compile(r"ekf-([\w-]+)|ekf\((?:.*, *)?association=([\w-]+).*\)")


def look(estimator: str) -> Look:
    """Colour, marker and line of an estimator by itself.

    Parameters
    ----------
    estimator : str
        Name. One that is neither in `LOOKS` nor the EKF with a method of `METHODS` gets a look of
        its own that depends on the name alone. Options that only say what is recovered, or which
        seed is drawn from, do not count.
    """
    return _choices(estimator)[0]


def _choices(estimator: str) -> list[Look]:
    """Looks that an estimator can have: its own, and those to go over to."""
    estimator = _SAME.sub("", estimator).replace(", )", ")").replace("()", "")
    if estimator in LOOKS:
        return [LOOKS[estimator]]
    method = _METHOD.fullmatch(estimator)
    own = METHODS.get(method[1] or method[2]) if method else None
    start = zlib.crc32(estimator.encode()) % len(_OTHERS)
    others = [*_OTHERS[start:], *_OTHERS[:start], *_SPARE]
    return others if own is None else [own, *others]


def looks(estimators: Iterable[str]) -> dict[str, Look]:
    """Looks of estimators that share a figure: none close to another, while there are enough.

    Parameters
    ----------
    estimators : iterable of str
        Names, in any order and also several times. Those of `LOOKS` always have their own look;
        where others come close to it or to one another in colour, or share a marker, the first one
        by the alphabet keeps it.
    """
    found: dict[str, Look] = {}
    for name in sorted(set(estimators), key=lambda name: (name not in LOOKS, name)):
        taken = list(found.values())
        found[name] = min(_choices(name), key=lambda choice: _clash(choice, taken))
    return found


def _clash(choice: Look, taken: list[Look]) -> tuple[float, bool, bool]:
    """How much a look is like those that are taken."""
    nearest = min((apart(choice.color, own.color) for own in taken), default=_CLOSE)
    return (
        max(0.0, _CLOSE - nearest),
        choice.marker in [own.marker for own in taken],
        choice in taken,
    )


class Key(NamedTuple):
    """How a legend below a figure of some width is laid out: its labels in lines, and columns."""

    labels: list[str]
    columns: int

    @classmethod
    def of(cls, labels: Iterable[str], width: float, most: int) -> Key:
        """Labels that are long become several lines, so that more of them fit side by side."""
        lines = [textwrap.fill(each, _LABEL, break_long_words=False) for each in labels]
        letter, handle = 0.06, 0.55  # of the legend's font, and of what stands before a label [in]
        longest = max((len(line) for each in lines for line in each.split("\n")), default=0)
        return cls(lines, max(1, min(most, int(width / (letter * longest + handle)))))

    @property
    def height(self) -> float:
        """How much of the figure it takes [in]."""
        rows = -(-len(self.labels) // self.columns) or 1
        columns = [self.labels[i : i + rows] for i in range(0, len(self.labels), rows)]
        lines = [sum(1 + each.count("\n") for each in column) for column in columns]
        return 0.2 + 0.15 * max(lines, default=0)


def add_key(figure: Figure, handles: Mapping[str, Any], most: int, **options: Any) -> None:
    """One legend below all panels of a figure, of at most so many columns."""
    key = Key.of(handles, figure.get_figwidth(), most)
    options |= {"loc": "outside lower center", "ncols": key.columns}
    figure.legend(list(handles.values()), key.labels, **options)


def titled(width: float, *paragraphs: str) -> str:
    """The title of a figure of some width, in lines that fit."""
    letters = int(14.6 * width)
    return "\n".join(textwrap.fill(each, letters) for each in paragraphs if each)


def without(absent: Mapping[str, str]) -> str:
    """What a title says of those who are not in the figure, by name, and why."""
    listed = ", ".join(f"{name} ({why})" for name, why in absent.items())
    return f"nothing to show of {listed}" if listed else ""


@contextmanager
def style() -> Iterator[None]:
    """Settings of matplotlib for figures made or saved inside the ``with`` block."""
    with matplotlib.rc_context(_SETTINGS):
        yield


class Picture(Figure):
    """A figure that a notebook shows although pyplot, with its global list, never hears of it."""

    def _repr_png_(self) -> bytes:
        return _render(self, "png", dpi=150, metadata={"Software": None})


@contextmanager
def drawing(width: float, height: float) -> Iterator[Picture]:
    """An empty figure of a size in inches, to be drawn on inside the ``with`` block.

    Its layout is settled once, at the end: left to itself it shifts a little at every rendering.
    """
    with style():
        figure = Picture(figsize=(width, height), layout="constrained")
        yield figure
        for _ in range(2):  # the axes keep clear of the legend once it has its place
            figure.draw_without_rendering()
        figure.set_layout_engine("none")


def save(figure: Figure, folder: str | Path, stem: str) -> tuple[Path, Path]:
    """Write a figure as ``stem.png`` (200 dpi) and ``stem.pdf``; same figure, same bytes.

    What is too much for a vector file is a picture of 200 dpi in it.

    Parameters
    ----------
    figure : Figure
    folder : path
        Exists.
    stem : str
        Name of the files without suffix.

    Returns
    -------
    Path, Path
        The PNG and the PDF. Each appears whole or not at all.

    Raises
    ------
    InputError
        If the folder does not exist or cannot be written to.
    """
    undated = {"CreationDate": None}
    files = {
        Path(folder, f"{stem}.png"): _render(figure, "png", dpi=200, metadata={"Software": None}),
        Path(folder, f"{stem}.pdf"): _render(figure, "pdf", dpi=200, metadata=undated),
    }
    for path, content in files.items():
        with atomic_write(path) as stream:
            stream.write(content)
    png, pdf = files
    return png, pdf


def svg(figure: Figure) -> str:
    """A figure as SVG, with text as text; same figure, same characters."""
    undated = {"Date": None}
    return _render(figure, "svg", dpi=200, metadata=undated).decode("utf-8")


def _render(figure: Figure, form: str, **options: Any) -> bytes:
    stream = BytesIO()
    with style():
        figure.savefig(stream, format=form, **options)
    return stream.getvalue()
