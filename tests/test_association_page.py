"""The page on association: its tables are those that its commands wrote, its options exist."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pandas as pd
import pytest
from bars import FILE, TIGHT

from ekfslam.association.gates import Gates, chi2_gate
from ekfslam.experiments.association import METHODS, SCALES
from ekfslam.filters.options import ASSOCIATIONS, Options
from ekfslam.registry import resolve

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "association.md").read_text(encoding="utf-8")
STUDY = ROOT / "results" / "study-association"


def digits(value):
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"


def cell(row, quantity):
    if quantity == "precision":
        return f"{row['precision_mean']:.3f}"
    if quantity == "ATE [m]":
        return f"{row['ate_m_mean']:.2f} ± {row['ate_m_se']:.2f}"
    return f"{digits(row['nees_median'])}, {row['share_diverged']:.0%}"


def study_rows():
    """The tables of the page from the summary of the study, line by line."""
    summary = pd.read_csv(STUDY / "summary.csv").set_index(["method", "odometry_noise"])
    for quantity in ("precision", "ATE [m]", "median NEES, diverged"):
        yield f"| {quantity} | " + " | ".join(f"noise × {scale:g}" for scale in SCALES) + " |"
        for method in METHODS:
            cells = [cell(summary.loc[method, scale], quantity) for scale in SCALES]
            yield f"| `{method}` | " + " | ".join(cells) + " |"


def paired_row():
    table = pd.read_csv(STUDY / "paired.csv")
    assert table["odometry_noise"].tolist() == list(SCALES)
    cells = [
        f"{row['ate_m_difference_mean']:.3f} ± {row['ate_m_difference_se']:.3f}"
        for _, row in table.iterrows()
    ]
    return "| joint − nearest [m] | " + " | ".join(cells) + " |"


def victoria_rows():
    """Landmarks, gap, precision and recall on Victoria Park."""
    table = pd.read_csv(FILE)
    recorded = table[table["dataset"].str.startswith("victoria-park") & (table["runs"] == 1)]
    for (dataset, estimator), rows in recorded.groupby(["dataset", "estimator"], sort=False):
        count, gap, precision, recall = rows["value"]
        noise = "near the residuals" if dataset == TIGHT else "default"
        cells = f"{count:.0f} | {gap:.1f} | {precision:.3f} | {recall:.3f}"
        yield f"| {noise} | `{estimator}` | {cells} |"


LINES = [*study_rows(), paired_row(), *victoria_rows()]


@pytest.mark.parametrize("line", LINES)
def test_its_tables_are_what_the_commands_wrote(line):
    assert line in PAGE.splitlines()


def test_its_shares_are_those_of_the_table():
    table = pd.read_csv(FILE)
    share = table[table["quantity"] == "share that meets both"].iloc[0]
    met = round(share["value"] * share["runs"])
    assert f"of {share['runs']} choices around it {met} reach both bars" in " ".join(PAGE.split())


def test_joint_compatibility_beats_nearest_neighbour_where_noise_is_high():
    """What the page says first of its table."""
    table = pd.read_csv(STUDY / "paired.csv").set_index("odometry_noise")
    z = table["ate_m_difference_mean"] / table["ate_m_difference_se"]
    assert (z[[4.0, 6.0]] < -2).all()
    assert (z[[1.0, 2.0, 3.0]].abs() < 2).all()
    summary = pd.read_csv(STUDY / "summary.csv")
    assert not summary[summary["method"] == "joint"]["share_diverged"].any()


def test_it_has_a_row_for_every_method_and_speaks_of_options_that_there_are():
    methods = set(re.findall(r"^\| `([\w-]+)` \| .* \| .* \| ", PAGE, flags=re.M))
    assert methods >= set(ASSOCIATIONS)
    (options,) = re.findall(r"## Options\n(.*?)\n##", PAGE, flags=re.S)
    named = {
        name
        for line in options.splitlines()
        for name in re.findall(r"`(\w+)`", line.split("|")[1] if "|" in line else "")
    }
    known = {field.name: field.default for field in fields(Options)}
    assert named - {"option"} <= set(known)
    assert len(named) > 10
    for estimator in re.findall(r'"(ekf[^"]*)"|`((?:ekf|gtsam-batch)\([^`]*\))`', PAGE):
        for name in re.split(r", (?=ekf|gtsam)", estimator[0] or estimator[1]):
            resolve(name)


def test_the_thresholds_that_it_states():
    gates = Gates()
    assert "0.999, 0.999999" in PAGE
    assert (gates.accept, gates.new) == (0.999, 0.999999)
    two, one = ([f"{chi2_gate(p, d):.1f}" for p in (gates.accept, gates.new)] for d in (2, 1))
    assert f"{two[0]} and {two[1]} for range and bearing, {one[0]} and {one[1]} for" in PAGE
