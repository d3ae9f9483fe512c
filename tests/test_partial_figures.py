"""Figures of truth that is known in part: lines break, nothing is drawn that nobody knows."""

from __future__ import annotations

import matplotlib
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2
from test_partial_truth import COUNT, along, drawn, gaps

from ekfslam import geometry as geo
from ekfslam import plots
from ekfslam.estimates import Estimate, LandmarkEstimates
from ekfslam.evaluation import tables
from ekfslam.plots.rows import isolated
from ekfslam.plots.style import TRUTH

NAN = np.nan


@pytest.fixture(scope="module")
def run():
    """Truth, and an estimate with covariances."""
    rng = np.random.default_rng(7)
    truth = geo.integrate([8.0, -6.0, 1.0], np.tile([0.5, 0.0, 0.1], (COUNT - 1, 1)))
    landmark = LandmarkEstimates(np.array([3]), np.array([[2.0, 1.0]]), 0.01 * np.eye(2)[None])
    samples = np.linspace(90.0, 30.0, COUNT)
    return truth, Estimate(
        "ekf", "curve", "known", drawn(rng, truth, 0.1), None, landmark, effective_samples=samples
    )


@pytest.fixture(params=["gaps", "every fifth"])
def masked(request, run):
    """Truth with gaps, and which poses of it are known."""
    if request.param == "gaps":
        return gaps(run[0])
    known = np.arange(COUNT) % 5 == 2
    return np.where(known[:, None], run[0], NAN), known


def table(run, truth):
    return tables.trajectories(along(truth), run[1])


def without_headings(truth):
    return np.column_stack([truth[:, :2], np.full(len(truth), NAN)])


def drawn_points(artists):
    """What a reader sees: the ends of what is drawn between two neighbours, and dots."""
    seen = set()
    for artist in artists:
        x, y = (np.asarray(values, float) for values in artist.get_data())
        finite = np.isfinite(x) & np.isfinite(y)
        if artist.get_linestyle() == "None":
            shown = finite
        else:
            beside = np.concatenate([[False], finite, [False]])
            shown = finite & (beside[:-2] | beside[2:])
        seen |= set(zip(x[shown], y[shown], strict=True))
    return seen


def test_isolated_values_have_no_neighbour():
    values = np.array([1.0, NAN, 2.0, 3.0, NAN, 4.0, NAN, NAN, 5.0])
    assert_array_equal(np.flatnonzero(isolated(values)), [0, 5, 8])
    both = np.column_stack([values, np.where(np.arange(9) == 2, NAN, values)])
    assert_array_equal(np.flatnonzero(isolated(both)), [0, 3, 5, 8])
    assert not isolated(np.empty(0)).any()


def test_every_known_error_is_seen_and_no_other(run, masked):
    truth, known = masked
    rows = table(run, truth)
    figure = plots.plot_errors(rows)
    for panel, name in zip(figure.axes, ("x", "y"), strict=False):
        lines = [line for line in panel.lines if len(line.get_xdata()) != 2]
        error = rows[f"error_{name}_m"].to_numpy()
        assert drawn_points(lines) == set(zip(rows.time_s[known], error[known], strict=True))


def test_without_true_headings_their_band_stands_alone(run, masked):
    rows = table(run, without_headings(masked[0]))
    heading = plots.plot_errors(rows).axes[2]
    assert [text.get_text() for text in heading.texts] == ["no true heading"]
    assert not drawn_points(line for line in heading.lines if len(line.get_xdata()) != 2)
    (band,) = heading.collections
    top = band.get_paths()[0].vertices[:, 1].max()
    assert top == pytest.approx(3 * np.degrees(np.sqrt(rows.cov_tt.max())))
    assert top < heading.get_ylim()[1]
    full = plots.plot_errors(table(run, run[0]))
    assert not [text for panel in full.axes for text in panel.texts]


@pytest.mark.parametrize(("headings", "dof"), [(True, 3), (False, 2)])
def test_nees_is_of_what_is_known_in_the_interval_of_that(run, masked, headings, dof):
    truth, known = masked
    rows = table(run, truth if headings else without_headings(truth))
    (panel,) = [a for a in plots.plot_consistency(rows).axes if "NEES" in a.get_title()]
    what = "pose" if headings else "position"
    assert panel.get_title() == f"NEES of the {what}, online"
    bounds = [line for line in panel.lines if line.get_label() == "95 % interval"]
    assert_allclose([line.get_ydata()[0] for line in bounds], chi2.ppf([0.025, 0.975], dof))
    nees = rows["nees" if headings else "nees_position"].to_numpy()
    seen = drawn_points(line for line in panel.lines if line not in bounds)
    assert seen == set(zip(rows.time_s[known], nees[known], strict=True))


def test_of_nothing_known_there_is_what_there_is_without_a_truth(run):
    rows = table(run, np.full((COUNT, 3), NAN))
    assert "no truth" in plots.plot_errors(rows).get_suptitle()
    titles = [axes.get_title() for axes in plots.plot_consistency(rows).axes]
    assert titles == ["effective sample size"]


@pytest.mark.parametrize("headings", [True, False])
def test_the_map_shows_the_known_positions_and_marks_known_ends_alone(run, masked, headings):
    truth, known = masked
    rows = table(run, truth if headings else without_headings(truth))
    landmarks = tables.landmarks(along(truth), run[1])
    axes = plots.plot_map(rows, landmarks).axes[0]
    black = [line for line in axes.lines if line.get_color() == TRUTH]
    path = [line for line in black if line.get_marker() in ("None", ".")]
    assert drawn_points(path) == set(zip(*truth[known, :2].T, strict=True))
    (starts,) = [line for line in black if line.get_marker() == ">"]
    assert drawn_points([starts]) == {tuple(rows.loc[0, ["x_m", "y_m"]])}
    ends = [line for line in black if line.get_marker() == "s"]
    assert not drawn_points(ends)
    whole = plots.plot_map(table(run, run[0]), landmarks).axes[0]
    squares = [a for a in whole.lines if a.get_marker() == "s" and a.get_color() == TRUTH]
    assert drawn_points(squares) == {tuple(run[0][-1, :2])}


def test_effective_samples_have_a_panel_of_their_own(run):
    panel = plots.plot_consistency(table(run, run[0])).axes[-1]
    assert panel.get_title() == "effective sample size"
    (line,) = panel.lines
    assert_array_equal(line.get_ydata(), run[1].effective_samples)
    assert matplotlib.colors.to_hex(line.get_color()) == plots.look("ekf").color.lower()


def test_notes_on_nees_stand_where_nees_is(run):
    notes = ["range errors are correlated: NEES is too large", "1234 rows were read"]
    title = plots.plot_consistency(table(run, run[0]), notes=notes).get_suptitle()
    assert notes[0] in title
    assert notes[1] not in title
    nothing = table(run, np.full((COUNT, 3), NAN))
    assert notes[0] not in plots.plot_consistency(nothing, notes=notes).get_suptitle()
