"""A run as a film: paths, ellipses and measurements as they come."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from PIL import Image

from ekfslam import geometry as geo
from ekfslam.checks import checked_number
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.estimates import Estimate, Trajectory
from ekfslam.geometry import Array
from ekfslam.moments import sight_lines
from ekfslam.plots.maps import SIGMAS, frame, leaves, widened
from ekfslam.plots.style import QUIET, TRUTH, Key, Look, add_key, drawing, looks, style, titled
from ekfslam.storage import atomic_write

INCHES = 6.0
"""Width of a film's figure: its text has the size that it has on a page of this width."""

_COLORS = 128  # of a GIF, which has one palette for all pictures
_WIDTHS = (100, 4000)  # pixels
_ELLIPSES = 300  # of each estimator in a picture, the newest
_BESIDE = 0.5  # the axes, for their labels [in]


class Film(NamedTuple):
    """What a film shows.

    Attributes
    ----------
    dataset : Dataset
    steps : sequence of int
        A picture each, in order.
    estimates : dict
        By the name of the estimator, what it says at each of these steps: an `Estimate` of the run
        as far as it (`ekfslam.moments.until`).
    """

    dataset: Dataset
    steps: Sequence[int]
    estimates: Mapping[str, Sequence[Estimate]]


def check_film(path: str | Path, fps: int = 12, width: int = 800) -> None:
    """Refuse a film that cannot be written, before hours of work depend on it.

    Raises
    ------
    InputError
        For an ending other than .gif and .mp4, an .mp4 where there is no ffmpeg, a folder that does
        not exist, or a rate or width that makes no sense.
    """
    path = Path(path)
    if path.suffix not in (".gif", ".mp4"):
        raise InputError(f"cannot write {path}: a film ends in .gif or .mp4")
    if not path.parent.is_dir():
        raise InputError(f"cannot write {path}: there is no folder {path.parent}")
    if path.suffix == ".mp4" and not FFMpegWriter.isAvailable():
        raise InputError(
            f"cannot write {path}: an .mp4 needs ffmpeg, which is not here; install it "
            "(apt install ffmpeg, brew install ffmpeg), or write a .gif, which needs nothing"
        )
    if not (1 <= checked_number(fps, "fps") <= 50 and fps == int(fps)):
        raise InputError(f"fps must be a whole number of pictures a second, 1 to 50, got {fps}")
    if not _WIDTHS[0] <= checked_number(width, "width") <= _WIDTHS[1]:
        raise InputError(f"width must be from {_WIDTHS[0]} to {_WIDTHS[1]} pixels, got {width}")


def save_film(
    film: Film,
    path: str | Path,
    fps: int = 12,
    width: int = 800,
    watch: Callable[[int, int], None] | None = None,
) -> Path:
    """Write a film as GIF or MP4; same film, same pictures.

    Each picture shows what is known at its step: the path so far, which a smoother bends as it
    learns; the landmarks and the last pose with 3-sigma ellipses; and what was seen last, as lines
    from where the first estimator takes the robot to be. Of more than 300 landmarks of an estimator
    the newest have ellipses. The last picture stays for two seconds.

    Parameters
    ----------
    film : Film
    path : path
        Ends in ``.gif`` or ``.mp4``; the latter needs the program ffmpeg.
    fps : int
        Pictures a second; a GIF rounds their time to 10 ms.
    width : int
        In pixels; rounded to an even number, as the height is.
    watch : callable, optional
        Called with (pictures done, pictures in all).

    Returns
    -------
    Path
        The file, which appears whole or not at all.

    Raises
    ------
    InputError
        As `check_film`.
    """
    path = Path(path)
    check_film(path, fps, width)
    write = _write_gif if path.suffix == ".gif" else _write_mp4
    with atomic_write(path) as stream, tempfile.TemporaryDirectory() as place, style():
        scratch = Path(place, f"film{path.suffix}")
        write(_Stage(film, int(width)), scratch, fps, watch or _nobody)
        stream.write(scratch.read_bytes())
    return path


def _nobody(done: int, total: int) -> None:
    """Nobody is told."""


# Files ------------------------------------------------------------------------------------------


def _write_gif(stage: _Stage, path: Path, fps: int, watch: Callable[[int, int], None]) -> None:
    count = len(stage.film.steps)
    palette = _palette(stage.picture(count - 1), stage.colors)  # the last one has all colours

    def pictures() -> Iterator[Image.Image]:
        for index in range(count):
            yield _few(stage.picture(index), palette)
            watch(index + 1, count)

    shown = pictures()
    time = round(100 / fps) * 10
    next(shown).save(
        path,
        save_all=True,
        append_images=shown,
        duration=[time] * (count - 1) + [max(2000, time)],
        loop=0,
    )


_WHITENED = [value if value < 248 else 255 for value in range(256)] * 3


def _palette(picture: Image.Image, colors: Sequence[str]) -> Image.Image:
    """The colours of a picture, and some as they are: a thin line has too few points to count."""
    found = picture.point(_WHITENED).quantize(_COLORS - len(colors), dither=Image.Dither.NONE)
    own = [round(255 * value) for color in colors for value in to_rgb(color)]
    known = (found.getpalette() or [])[: 3 * (_COLORS - len(colors))]
    palette = Image.new("P", (1, 1))
    palette.putpalette(own + known)
    return palette


def _few(picture: Image.Image, palette: Image.Image) -> Image.Image:
    """A picture in few colours, of which white is one: almost white would take its place."""
    white = picture.point(_WHITENED)
    return white.quantize(palette=palette, dither=Image.Dither.NONE)


def _write_mp4(stage: _Stage, path: Path, fps: int, watch: Callable[[int, int], None]) -> None:
    count, hold = len(stage.film.steps), 2 * int(fps)
    writer = FFMpegWriter(fps=int(fps), codec="h264", extra_args=["-fflags", "+bitexact"])
    with writer.saving(stage.figure, str(path), stage.figure.dpi):
        for index in range(count):
            stage.show(index)
            writer.grab_frame()
            watch(index + 1, count)
        for _ in range(hold):
            writer.grab_frame()


# Pictures ---------------------------------------------------------------------------------------


class _Stage:
    """The figure of a film, on which one picture is shown at a time."""

    def __init__(self, film: Film, width: int) -> None:
        self.film, self._artists = film, list[Artist]()
        self._looks = looks(film.estimates)
        self._low, self._high = _view(film)
        self._far = float(np.hypot(*(self._high - self._low)))
        self.figure, self._axes = self._set(width)
        self._told = self.figure.suptitle(self._words(len(film.steps) - 1), x=0.02, ha="left")

    def _set(self, width: int) -> tuple[Figure, Axes]:
        """An empty figure of an even number of pixels, with all that stays as it is."""
        labels = {name: self._label(name) for name in self.film.estimates}
        names = [*labels.values(), "truth", "true landmark"]
        aspect = float(np.divide(*(self._high - self._low)[::-1]))
        height = (INCHES - _BESIDE) * float(np.clip(aspect, 0.3, 1.2))
        height += 0.65 + Key.of(names, INCHES, most=4).height
        pixels = 2 * round(width * height / INCHES / 2)
        dpi = 2 * round(width / 2) / INCHES
        with drawing(INCHES, pixels / dpi) as figure:
            figure.set_dpi(dpi)
            FigureCanvasAgg(figure)
            axes = figure.add_subplot(aspect="equal", xlabel="x [m]", ylabel="y [m]")
            axes.set(xlim=(self._low[0], self._high[0]), ylim=(self._low[1], self._high[1]))
            figure.suptitle(titled(INCHES, self._words(len(self.film.steps) - 1)))
            handles: dict[str, Any] = {
                label: Line2D([], [], **_line(self._looks[name])) for name, label in labels.items()
            }
            known = self.film.dataset.true_map
            if known is not None and len(known):
                axes.plot(*known.positions.T, "+", color=QUIET, markersize=4, zorder=2)
                handles["true landmark"] = Line2D([], [], color=QUIET, marker="+", linestyle="")
            if any(robot.truth is not None for robot in self.film.dataset.robots):
                handles["truth"] = Line2D([], [], color=TRUTH, linewidth=0.8)
            add_key(figure, handles, most=4)
        return figure, axes

    @property
    def colors(self) -> list[str]:
        """Of the estimators."""
        return list(dict.fromkeys(own.color for own in self._looks.values()))[: _COLORS // 2]

    def _label(self, name: str) -> str:
        """What the legend calls an estimator."""
        last = self.film.estimates[name][-1]
        trajectory, mapped = last.final_trajectory, last.landmarks
        if trajectory is None:
            return f"{name} ({last.status})"
        series = "smoothed" if last.smoothed is not None else "online"
        places = [trajectory.poses.reshape(-1, 3)[:, :2]]
        places += [] if mapped is None else [mapped.positions]
        beyond = leaves(np.concatenate(places), (self._low, self._high))
        return f"{name} ({series})" + ", leaves the frame" * beyond

    def picture(self, index: int) -> Image.Image:
        """One of the film's pictures."""
        self.show(index)
        canvas = self.figure.canvas
        assert isinstance(canvas, FigureCanvasAgg)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")

    def show(self, index: int) -> None:
        """Put one of the film's pictures on the figure."""
        for artist in self._artists:
            artist.remove()
        self._artists.clear()
        self._told.set_text(self._words(index))
        step = self.film.steps[index]
        for robot in self.film.dataset.robots:
            if robot.truth is not None:
                self._add_line(robot.truth[: step + 1], color=TRUTH, linewidth=0.8, zorder=5)
        for place, (name, estimates) in enumerate(self.film.estimates.items()):
            self._show_estimate(estimates[index], self._looks[name], 4.0 + 0.01 * place)
        self._show_sights(index)

    def _words(self, index: int) -> str:
        dataset, step = self.film.dataset, self.film.steps[index]
        seed = "" if dataset.seed is None else f", seed {dataset.seed}"
        passed = dataset.times[step] - dataset.times[0]
        return f"{dataset.name}{seed}: step {step} of {dataset.poses - 1}, {passed:.1f} s"

    def _add_line(self, places: Array, **appearance: Any) -> None:
        self._artists += self._axes.plot(places[:, 0], places[:, 1], **appearance)

    def _add_lines(self, lines: list[Array], **appearance: Any) -> None:
        drawn = LineCollection(lines, **appearance)
        self._artists.append(self._axes.add_collection(drawn, autolim=False))

    def _show_estimate(self, estimate: Estimate, own: Look, zorder: float) -> None:
        """As on a map, the last one lies on top: who has dashes does not hide a whole line."""
        trajectory = estimate.final_trajectory
        if trajectory is None:
            return
        for path, covariances in _robots(trajectory):
            self._add_line(path, **_line(own), zorder=zorder)
            x, y, heading = path[-1]
            if np.isfinite(path[-1]).all():
                marker = (3, 0, float(np.degrees(heading)) - 90)
                self._add_line(
                    np.array([[x, y]]),
                    color=own.color,
                    marker=marker,
                    markersize=6,
                    zorder=3 + zorder,
                )
            if covariances is not None:
                self._add_ellipses(path[-1:, :2], covariances[-1:, :2, :2], own, 1.2, zorder)
        mapped = estimate.landmarks
        if mapped is not None and len(mapped):
            self._add_line(
                mapped.positions,
                color=own.color,
                marker=own.marker,
                linestyle="none",
                markersize=2,
                markeredgewidth=0.5,
                zorder=zorder,
            )
            if mapped.covariances is not None:
                newest = slice(-_ELLIPSES, None)
                self._add_ellipses(
                    mapped.positions[newest], mapped.covariances[newest], own, 0.7, zorder
                )

    def _add_ellipses(
        self, means: Array, covariances: Array, own: Look, linewidth: float, zorder: float
    ) -> None:
        self._add_lines(
            _contours(means, covariances),
            colors=own.color,
            linestyles=own.linestyle,
            linewidths=linewidth,
            zorder=zorder,
        )

    def _show_sights(self, index: int) -> None:
        """What was seen last since the picture before, from the first estimator that has a pose."""
        before = self.film.steps[index - 1] if index else -1
        offsets = self.film.dataset.offsets
        for step in range(self.film.steps[index], before, -1):
            if offsets[step + 1] > offsets[step]:
                break
        else:
            return
        for name, estimates in self.film.estimates.items():
            trajectory = estimates[index].final_trajectory
            if trajectory is not None:
                poses = np.stack([path[step] for path, _ in _robots(trajectory)])
                lines = sight_lines(self.film.dataset, step, poses, self._far)
                color = self._looks[name].color
                self._add_lines(lines, colors=color, linewidths=0.6, alpha=0.5, zorder=3)
                return


def _contours(means: Array, covariances: Array) -> list[Array]:
    good = np.isfinite(means).all(axis=1) & np.isfinite(covariances).all(axis=(1, 2))
    return list(geo.ellipse(means[good], covariances[good], SIGMAS))


def _robots(trajectory: Trajectory) -> list[tuple[Array, Array | None]]:
    """Poses and covariances of each robot."""
    count = 1 if trajectory.poses.ndim == 2 else len(trajectory.poses)
    each = [trajectory.of_robot(robot) for robot in range(count)]
    return [(one.poses, one.covariances) for one in each]


def _line(own: Look) -> dict[str, Any]:
    return {"color": own.color, "linestyle": own.linestyle, "linewidth": 1.2}


def _view(film: Film) -> tuple[Array, Array]:
    """Corners of what the film shows throughout: that of its last picture."""
    dataset, step = film.dataset, film.steps[-1]
    truths = [r.truth[: step + 1, :2] for r in dataset.robots if r.truth is not None]
    known = [] if dataset.true_map is None else [dataset.true_map.positions]
    truth = np.concatenate([*truths, *known, np.zeros((0, 2))])
    shown, contours = [], list[Array]()
    for estimates in film.estimates.values():
        trajectory, mapped = estimates[-1].final_trajectory, estimates[-1].landmarks
        if trajectory is not None:
            places = trajectory.poses.reshape(-1, 3)[:, :2]
            shown.append((places, np.zeros((0, 2)) if mapped is None else mapped.positions))
        if mapped is not None and mapped.covariances is not None:
            newest = slice(-_ELLIPSES, None)
            contours += _contours(mapped.positions[newest], mapped.covariances[newest])
    return widened(frame(truth[np.isfinite(truth).all(axis=1)], shown), contours)
