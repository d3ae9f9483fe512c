"""Figures as SVG inside the page: real text, colours that follow the page, no more than is seen."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from ekfslam.experiments.comparison import without_estimate
from ekfslam.plots import plot_consistency, plot_errors, plot_times
from ekfslam.plots.campaign import plot_campaign
from ekfslam.plots.style import svg
from ekfslam.report.comparison import runs_of
from ekfslam.report.folder import CampaignFolder, ComparisonFolder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STEPS = 1500
"""Steps of a run up to which bands of errors are drawn from all of them."""

_CELL = 0.5  # of two markers closer than this only one is seen [pt]

_CAPTIONS = {
    "errors": "Error against time within the estimator's own 3σ band, where there is a truth; "
    "otherwise the standard deviations that the estimators claim.",
    "consistency": "NEES and NIS against the 95 % intervals of one sample. The NEES along a run is "
    "worth almost one sample.",
    "times": "Time of each step.",
    "nees-over-time": "Mean NEES of the pose over the runs at each step; the band is where it "
    "should be.",
    "run-means": "Mean NEES along each run: quartiles, tails, median and mean, and how many "
    "diverged.",
    "errors-over-time": "Root mean square errors over the runs at each step, and what the "
    "estimators claim.",
    "pairs": "Mean differences on the same seeds with their intervals; filled where one is seen.",
    "sweep": "What estimators reach against the value that was swept.",
    "option": "What estimators reach against a number among their options.",
}


class Drawing(NamedTuple):
    """A figure of the page: its caption, in whose section it stands, and SVG."""

    title: str
    caption: str
    svg: str


class Ink:
    """Styles and colours of all drawings of a page, each written once."""

    def __init__(self) -> None:
        self.classes: dict[str, str] = {}
        self.colors: set[str] = set()
        self._drawings = 0

    def inline(self, text: str) -> str:
        """What matplotlib wrote as part of a page: without what it says twice or nobody sees."""
        self._drawings += 1
        text = text[text.index("<svg") :]
        text = re.sub(
            r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.S
        )
        text = re.sub(r">\s+<", "><", text)
        text = re.sub(r'(?<= )(d|x|y)="([^"]*)"', self._shorter, text)
        text = self._names(text)
        text = _markers_seen(text)
        text = re.sub(r' style="([^"]*)"', self._class, text)
        text = text.replace("<defs></defs>", "").replace("<defs/>", "")
        return re.sub(r'<svg [^>]*?(viewBox="[^"]*")[^>]*>', r"<svg \1>", text, count=1)

    def _names(self, text: str) -> str:
        """Names that are referred to, told apart from those of other drawings."""
        used = set(re.findall(r'(?:href="|url\()#([^")]+)', text))

        def named(match: re.Match[str]) -> str:
            return f' id="f{self._drawings}-{match[1]}"' if match[1] in used else ""

        text = re.sub(r' id="([^"]*)"', named, text)
        text = re.sub(r"url\(#", f"url(#f{self._drawings}-", text)
        return re.sub(r'xlink:href="#', f'href="#f{self._drawings}-', text)

    def _shorter(self, match: re.Match[str]) -> str:
        numbers = re.sub(r"-?\d+\.\d{2,}", _rounded, match[2])
        return f'{match[1]}="{" ".join(numbers.split())}"'

    def _class(self, match: re.Match[str]) -> str:
        style = re.sub(r"#[0-9a-f]{6}\b", lambda m: self.color(m[0][1:]), match[1])
        name = self.classes.setdefault(style, f"s{len(self.classes)}")
        return f' class="{name}"'

    def color(self, code: str) -> str:
        """A colour, six hexadecimal digits, as the page's variable for it."""
        self.colors.add(code)
        return f"var(--c{code})"

    @property
    def css(self) -> str:
        """Rules for everything that was drawn."""
        light = "".join(f"--c{code}:#{code};" for code in sorted(self.colors))
        dark = "".join(f"--c{code}:#{on_dark(code)};" for code in sorted(self.colors))
        rules = "".join(f".{name}{{{style}}}" for style, name in self.classes.items())
        night = f"@media screen and (prefers-color-scheme:dark){{:root{{{dark}}}}}"
        return f":root{{{light}}}{night}{rules}"


def _rounded(number: re.Match[str]) -> str:
    """To a tenth of a point; what is small, such as a marker, to a hundredth."""
    value = float(number[0])
    return f"{value:.1f}" if abs(value) >= 10 else f"{value:.2f}"


def _markers_seen(text: str) -> str:
    """Without markers that lie on another one of their kind."""
    seen: set[tuple[str, int, int]] = set()

    def once(match: re.Match[str]) -> str:
        cell = (match[1], round(float(match[2]) / _CELL), round(float(match[3]) / _CELL))
        if cell in seen:
            return ""
        seen.add(cell)
        return match[0]

    return re.sub(r'<use href="([^"]*)" x="([^"]*)" y="([^"]*)"[^>]*/>', once, text)


PAPER_DARK = "16181d"
_LEAST = 3.0  # contrast of what is drawn with the page (WCAG 2.2, 1.4.11)


def on_dark(code: str) -> str:
    """A colour as it is on the dark page: grey turned around, others lighter as far as needed."""
    rgb = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)], dtype=float)
    if np.ptp(rgb) == 0:
        if rgb[0] == 255:
            return PAPER_DARK
        level = 235.0 - 0.5 * rgb[0] if rgb[0] < 192 else 275.0 - rgb[0]
        return f"{round(level):02x}" * 3
    mixed = rgb
    for share in np.linspace(0.0, 1.0, 21):
        mixed = rgb + share * (255.0 - rgb)
        if contrast(mixed, PAPER_DARK) >= _LEAST:
            break
    return "".join(f"{round(value):02x}" for value in mixed)


def contrast(rgb: Any, code: str) -> float:
    """Contrast of two colours, 1 to 21 (WCAG 2.2)."""
    other = np.array([int(code[i : i + 2], 16) for i in (0, 2, 4)], dtype=float)
    first, second = sorted((_luminance(np.asarray(rgb, float)), _luminance(other)))
    return (second + 0.05) / (first + 0.05)


def _luminance(rgb: np.ndarray) -> float:
    share = rgb / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


# Whose figures -----------------------------------------------------------------------------------


def of_comparison(results: ComparisonFolder, ink: Ink) -> list[Drawing]:
    """Errors, consistency and times of each dataset and robot."""
    found = []
    for run in runs_of(results.trajectories):
        rows = _plain(run.rows)
        dataset = run.rows["dataset"].iloc[0]
        notes = results.config["datasets"].get(dataset, {}).get("notes", ())
        lacking = without_estimate(results.summary[results.summary["dataset"] == dataset])
        absent = {_escaped(name): why for name, why in lacking.items()}
        told = [_escaped(str(note)) for note in notes]
        some, every = _thinned(rows)
        drawn_of = f" Drawn from every {every}th step." if every > 1 else ""
        robots = list(rows["robot"].unique()) if run.robots else [None]
        for robot in robots:
            whose = f"{run.title}, {robot}" if robot else run.title
            figure = plot_errors(some, robot, absent)
            found.append(_drawing(whose, "errors", figure, ink, drawn_of))
            figure = plot_consistency(rows, robot, told, absent)
            found.append(_drawing(whose, "consistency", figure, ink))
        if rows["time_step_s"].notna().any():
            found.append(_drawing(run.title, "times", plot_times(rows, absent), ink))
    return found


def of_campaign(results: CampaignFolder, ink: Ink) -> list[Drawing]:
    """The figures that ``ekfslam summary`` draws."""
    tables = {
        name: _plain(getattr(results, name)) for name in ("summary", "over_time", "runs", "pairs")
    }
    figures = plot_campaign(**tables, config=_escaped(dict(results.config)))
    title = str(results.config["campaign"])
    return [
        _drawing(title, re.sub(r"-\d+$", "", stem), figure, ink) for stem, figure in figures.items()
    ]


def _drawing(title: str, kind: str, figure: Figure, ink: Ink, more: str = "") -> Drawing:
    return Drawing(title, _CAPTIONS[kind] + more, ink.inline(svg(figure)))


def _thinned(rows: pd.DataFrame) -> tuple[pd.DataFrame, int]:
    """Rows of every so many steps, so that bands are no more than can be seen."""
    steps = np.unique(rows["step"].to_numpy(np.int64))
    every = -(-len(steps) // STEPS)
    return (rows, 1) if every < 2 else (rows[rows["step"].isin(steps[::every])], every)


def _plain(table: pd.DataFrame) -> pd.DataFrame:
    """Names in which a dollar is a dollar: matplotlib would read a formula."""
    text = [name for name in table.columns if pd.api.types.is_string_dtype(table[name].dtype)]
    return table.assign(**{n: table[n].str.replace("$", r"\$", regex=False) for n in text})


def _escaped(value: Any) -> Any:
    if isinstance(value, str):
        return value.replace("$", r"\$")
    if isinstance(value, dict):
        return {_escaped(key): _escaped(each) for key, each in value.items()}
    return [_escaped(each) for each in value] if isinstance(value, list) else value
