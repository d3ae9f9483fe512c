"""Tables of numbers on pages, written from the tables of the benchmark: no number by hand."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

BEGIN, END = "<!-- written by make bench -->", "<!-- until here -->"

PROBLEMS = {"ring": "any five landmarks a step", "city": "a tour of the city"}
SHORT = {  # rows of the README, with what they are called there
    "Victoria Park: EKF, iSAM2": "Victoria Park: EKF with covariances, feeding iSAM2 from Python",
    "Victoria Park: covariances, batch": "Victoria Park: all covariances, batch's optimisation",
    "ring, 100 landmarks: ekf, textbook, joint": "map of 100: EKF, the textbook's in NumPy",
    "ring, 2000 landmarks: ekf, textbook, joint": "map of 2000: the same",
    "ring, 2000 landmarks: ekf, roboticstoolbox": "map of 2000: EKF, that of roboticstoolbox",
    "city, 2000 landmarks: ekf-compressed, textbook, joint": (
        "city of 2000: compressed EKF, the textbook's in NumPy"
    ),
    "city, 5000 landmarks: ekf-compressed, gtsam-isam2": "city of 5000: compressed EKF, iSAM2",
    "1000 landmarks, association (nearest), correction": "map of 1000: association, correction",
    "loop-15: all seven filters, batch": "`loop-15`, 100 runs: seven filters, batch",
    "park: fastslam2 of 100 particles, ekf": "`park`: FastSLAM 2.0 of 100 particles, EKF",
    "campaign of loop-15: two workers, one process": "a campaign: two workers, one process",
}


def renew(root: Path) -> None:
    """Write the numbers of ``results/bench`` into ``docs/speed.md`` and ``README.md``."""
    for name, text in tables(root).items():
        path = root / name
        path.write_text(replaced(path.read_text("utf-8"), text), "utf-8")


def tables(root: Path) -> dict[str, str]:
    """What stands between the marks of each page."""
    folder = root / "results" / "bench"
    speed = pd.read_csv(folder / "speed.csv")
    times = folder / "map-size.csv"
    sizes = by_size(pd.read_csv(times, dtype={"note": object})) if times.exists() else []
    short = speed[speed.what.isin(SHORT)].assign(what=lambda rows: rows.what.map(SHORT))
    return {
        "docs/speed.md": "\n".join([*sizes, *ratios(speed)]),
        "README.md": "\n".join(ratios(short, bounds=False)),
    }


def replaced(page: str, text: str) -> str:
    """A page with another text between its marks.

    Raises
    ------
    ValueError
        If the marks are not there.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"a page lacks {BEGIN} or {END}")
    return f"{before}{begin}\n\n{text}\n\n{end}{after}"


def by_size(table: pd.DataFrame) -> list[str]:
    """Time of an observation by estimator and size, and of a prediction behind it."""
    lines = []
    for problem, title in PROBLEMS.items():
        own = table[table.problem == problem].fillna({"note": ""})
        sizes = sorted(own.landmarks.unique())
        lines += [f"| {title} [µs] | " + " | ".join(f"{size} landmarks" for size in sizes) + " |"]
        lines += ["|---|" + "---:|" * len(sizes)]
        for estimator, rows in own.groupby("estimator", sort=False):
            times = zip(rows.us_per_observation, rows.us_per_prediction, rows.note, strict=True)
            texts = [note or ", ".join(filter(None, map(digits, pair))) for *pair, note in times]
            cells = dict(zip(rows.landmarks, texts, strict=True))
            lines += [f"| {estimator} | " + " | ".join(cells.get(s, "") for s in sizes) + " |"]
        lines += [""]
    return lines


def ratios(table: pd.DataFrame, bounds: bool = True) -> list[str]:
    """Rows of the table of ratios."""
    head = ["what", "ours", "other", "ratio", *(["bar", "holds"] if bounds else [])]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * 3 + "---|---|" * bounds]
    for row in table.fillna({"unit": "", "bound": "", "holds": ""}).itertuples():
        ours, other = (f"{digits(value)} {row.unit}".strip() for value in (row.ours, row.other))
        cells = [row.what, ours, "" if pd.isna(row.other) else other, digits(row.ratio)]
        cells += [row.bound, {True: "yes", False: "no"}.get(row.holds, "")] if bounds else []
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def digits(value: float) -> str:
    """Three digits, never as a power of ten; nothing for what there is not."""
    if pd.isna(value):
        return ""
    return f"{value:.3g}" if abs(value) < 1000 else f"{float(f'{value:.3g}'):.0f}"
