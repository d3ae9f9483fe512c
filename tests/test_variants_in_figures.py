"""Several option variants of one estimator in one figure: told apart, and their names fit."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from ekfslam import plots
from ekfslam.experiments import compare
from ekfslam.plots.style import LOOKS, METHODS
from ekfslam.simulation import load_scenario, simulate

LONG = "ekf(association=maximum-likelihood, confirm={}, within=8)"
NAMES = [LONG.format(count) for count in (1, 2, 3)] + ["ekf"]


@pytest.fixture(scope="module")
def comparison():
    scenario = load_scenario("cloister")
    return compare(simulate(replace(scenario, controls=scenario.controls[:30])), NAMES)


def test_a_method_has_its_look_in_whatever_form_it_is_written():
    for method, look in METHODS.items():
        assert plots.look(f"ekf-{method}") == look
        assert plots.look(f"ekf(association={method})") == look
        assert plots.look(f"ekf(confirm=3, association={method}, within=9)") == look
    for other in ("ekf(confirm=3)", "mine(association=joint)", "ekf(association=jointly)"):
        assert plots.look(other) != METHODS["joint"]


def test_variants_of_one_estimator_are_told_apart():
    joint, waiting = "ekf(association=joint)", "ekf(association=joint, confirm=3)"
    found = plots.looks([joint, waiting, "ekf(association=known)", "gtsam-batch", "ekf", joint])
    assert len(found) == 5
    assert len({look.color for look in found.values()}) == 5
    assert found["ekf"] == LOOKS["ekf"]
    assert found["gtsam-batch"] == LOOKS["gtsam-batch"]
    assert plots.looks([joint, waiting])[joint] == METHODS["joint"]


def test_more_estimators_than_colours_differ_in_line_and_marker():
    assert len(set(plots.looks(f"filter-{k}" for k in range(12)).values())) == 12
    assert len(plots.looks(f"filter-{k}" for k in range(40))) == 40


@pytest.mark.parametrize("kind", ["map", "errors", "consistency", "times"])
def test_long_names_stay_inside_of_their_figure(comparison, kind):
    """Headings wrap, and legends have fewer columns."""
    figure = getattr(comparison, f"plot_{kind}")()
    FigureCanvasAgg(figure).draw()
    width, height = figure.bbox.size
    headings = [axes.title.get_window_extent() for axes in figure.axes if axes.get_title()]
    for box in [*headings, *(legend.get_window_extent() for legend in figure.legends)]:
        assert 0 <= box.x0 <= box.x1 <= width
        assert 0 <= box.y0 <= box.y1 <= height
    below = max(legend.get_window_extent().y1 for legend in figure.legends) if figure.legends else 0
    labels = [axes.xaxis.label.get_window_extent() for axes in figure.axes if axes.get_xlabel()]
    assert min(box.y0 for box in labels) > below
    beside = sorted(headings, key=lambda box: box.x0) if kind == "errors" else []
    assert all(left.x1 <= right.x0 for left, right in pairwise(beside))


def test_variants_have_a_column_or_a_line_each(comparison):
    titles = [axes.get_title() for axes in comparison.plot_errors().axes if axes.get_title()]
    assert len(set(titles)) == len(NAMES)
    assert [" ".join(title.split()[:-1]).replace("maximum- ", "maximum-") for title in titles] == [
        *NAMES
    ]
    lines = [
        line
        for line in comparison.plot_map().axes[0].lines
        if str(line.get_label()).startswith("ekf")
    ]
    assert [str(line.get_label()) for line in lines] == [f"{name} (online)" for name in NAMES]
    assert len({line.get_color() for line in lines}) == len(NAMES)
