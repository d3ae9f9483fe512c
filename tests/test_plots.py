"""Figures: what is drawn is what the tables say; files; broken and empty tables."""

from __future__ import annotations

import matplotlib
import numpy as np
import pandas as pd
import pytest
from IPython.core.formatters import PNGFormatter
from lap import (
    LANDMARKS,
    SERIES,
    STEPS,
    floats,
    legend,
    line,
    of,
    points,
    ring,
    with_color,
    without_truth,
)
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from ekfslam import plots
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.evaluation import tables
from ekfslam.plots.style import TRUTH

NAMES = ("map", "errors", "consistency", "times")


@pytest.fixture(scope="module")
def run():
    """Tables `trajectories` and `landmarks` of one run, as the package types them."""
    return ring()


@pytest.fixture(scope="module")
def figures(run):
    """Each figure of the run, for looking only."""
    return {name: draw(name, run) for name in NAMES}


def draw(name, run):
    plot = getattr(plots, f"plot_{name}")
    return plot(*run) if name == "map" else plot(run[0])


def column(figure, estimator, series):
    """The three panels of a column of the figure of errors."""
    width = len(figure.axes) // 3
    titles = [axes.get_title() for axes in figure.axes[:width]]
    return figure.axes[titles.index(f"{estimator}\n{series}") :: width]


# The map ---------------------------------------------------------------------------------------


def test_map_ellipses_are_at_mahalanobis_distance_three(run, figures):
    trajectories, landmarks = run
    (axes,) = figures["map"].axes
    for estimator, series in [("ekf", "online"), ("gtsam-isam2", "smoothed")]:
        # of the landmarks and of the last pose
        gaussians = pd.concat(
            [of(landmarks, estimator, series), of(trajectories, estimator, series)[-1:]]
        )
        collections = [c for c in axes.collections if isinstance(c, LineCollection)]
        (contours,) = [
            c
            for c in collections
            if to_hex(c.get_edgecolor()[0]) == plots.look(estimator).color.lower()
        ]
        vertices = np.stack(contours.get_segments())
        means = floats(gaussians, "x_m", "y_m")
        matrices = floats(gaussians, "cov_xx", "cov_xy", "cov_xy", "cov_yy").reshape(-1, 2, 2)
        offset = vertices - means[:, None]
        squared = np.einsum("npi,nij,npj->np", offset, np.linalg.inv(matrices), offset)
        assert_allclose(np.sqrt(squared), 3.0, rtol=1e-8)


def test_map_shows_paths_landmarks_and_ends_on_equal_axes(run, figures):
    trajectories, landmarks = run
    (axes,) = figures["map"].axes
    ekf = of(trajectories, "ekf")
    assert axes.get_aspect() == 1.0
    assert_array_equal(points(line(axes, "ekf (online)")), floats(ekf, "x_m", "y_m"))
    assert_array_equal(points(line(axes, "truth")), floats(ekf, "true_x_m", "true_y_m"))
    crosses = points(line(axes, "true landmark"))
    assert_array_equal(np.unique(crosses, axis=0), np.unique(LANDMARKS, axis=0))
    estimated, end = [
        points(a) for a in with_color(axes.lines, "ekf") if a.get_linestyle() == "None"
    ]
    assert_array_equal(estimated, floats(of(landmarks, "ekf"), "x_m", "y_m"))
    assert_array_equal(end, floats(ekf[-1:], "x_m", "y_m"))
    assert floats(ekf[:1], "x_m", "y_m") in points(line(axes, "start"))


def test_map_shows_the_series_that_knows_most(run, figures):
    (axes,) = figures["map"].axes
    smoothed = of(run[0], "gtsam-isam2", "smoothed")
    assert_array_equal(points(line(axes, "gtsam-isam2")), floats(smoothed, "x_m", "y_m"))
    assert line(axes, "gtsam-isam2").get_label() == "gtsam-isam2 (smoothed)"


def test_map_takes_the_whole_true_map(run):
    known = np.array([[1.0, 2.0], [3.0, 4.0]])
    (axes,) = plots.plot_map(*run, known=known).axes
    assert_array_equal(points(line(axes, "true landmark")), known)


@pytest.mark.parametrize("truth", [True, False])
def test_map_is_not_squashed_by_a_path_that_drifts_away(run, truth):
    figure = plots.plot_map(*(run if truth else without_truth(run)))
    (axes,) = figure.axes
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    shown = [LANDMARKS, *(points(line(axes, name)) for name in ("ekf", "gtsam-isam2", "mine"))]
    low, high = np.concatenate(shown).min(axis=0), np.concatenate(shown).max(axis=0)
    assert left < low[0] < high[0] < right < 20
    assert bottom < low[1] < high[1] < top < 20
    leaving = [label for label in legend(figure) if "leaves the frame" in label]
    assert leaving == ["dead-reckoning (online), leaves the frame"]


def test_without_truth_the_frame_is_for_those_who_have_mapped_the_world(run):
    trajectories, landmarks = without_truth([of(run[0], "ekf"), of(run[1], "ekf")])
    stuck = trajectories.assign(estimator="stuck", x_m=0.0, y_m=0.0)
    for order in ([stuck, trajectories], [trajectories, stuck]):
        figure = plots.plot_map(pd.concat(order), landmarks)
        assert not any("leaves the frame" in label for label in legend(figure))


def test_map_leaves_out_what_has_no_ellipse(run, figures):
    trajectories, landmarks = run
    whole = figures["map"].axes[0].collections
    first = landmarks.index[landmarks["estimator"] == "ekf"][0]
    for column, value in [("cov_xx", np.nan), ("cov_xy", 9.0), ("cov_yy", -1.0), ("x_m", np.inf)]:
        broken = landmarks.reset_index(drop=True)
        broken.loc[first, column] = value
        collections = plots.plot_map(trajectories, broken).axes[0].collections
        counts = [len(c.get_segments()) for c in collections]
        assert counts[0] == len(whole[0].get_segments()) - 1
        assert counts[1:] == [len(c.get_segments()) for c in whole[1:]]


def test_no_ellipse_at_the_edge_of_the_map_looks_as_if_it_ended_there(run):
    trajectories, landmarks = run
    (axes,) = plots.plot_map(*run).axes
    extent = np.ptp(axes.get_xlim())
    wide = landmarks.reset_index(drop=True)
    wide["cov_xx"] = wide["cov_yy"] = (extent / 30) ** 2
    wide["cov_xy"] = 0.0
    (axes,) = plots.plot_map(trajectories, wide).axes
    vertices = np.concatenate(axes.collections[0].get_segments())  # of the first estimator
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
    assert (low < vertices).all()
    assert (vertices < high).all()
    assert np.abs(vertices).max() > 0.55 * extent  # out of what there was room for without them
    wide.loc[0, "cov_xx"] = 1e6  # nothing else would be seen
    (axes,) = plots.plot_map(trajectories, wide).axes
    assert np.ptp(axes.get_xlim()) < 1.5 * extent


def test_the_legend_says_whose_landmarks_leave_the_map(run):
    trajectories, landmarks = run
    ekf = (landmarks["estimator"] == "ekf").to_numpy()
    away = landmarks.assign(x_m=landmarks["x_m"] + np.where(ekf, 500.0, 0.0))
    leaving = [label for label in legend(plots.plot_map(trajectories, away)) if "leaves" in label]
    assert "ekf (online), leaves the frame" in leaving


# Errors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("estimator", "series"), SERIES[:3])
def test_error_panels_show_the_error_within_three_of_its_own_sigmas(
    run, figures, estimator, series
):
    panels = column(figures["errors"], estimator, series)
    rows = of(run[0], estimator, series)
    unit = [1.0, 1.0, 180 / np.pi]
    errors = floats(rows, "error_x_m", "error_y_m", "error_theta_rad") * unit
    bands = 3 * np.sqrt(floats(rows, "cov_xx", "cov_yy", "cov_tt")) * unit
    for panel, error, band in zip(panels, errors.T, bands.T, strict=True):
        (curve,) = [a for a in panel.lines if len(a.get_xdata()) == STEPS]
        assert_allclose(points(curve), np.column_stack([rows["time_s"], error]), rtol=1e-14)
        vertices = panel.collections[0].get_paths()[0].vertices
        for time, height in zip(rows["time_s"], band, strict=True):
            edges = vertices[vertices[:, 0] == time, 1]
            assert_allclose([edges.min(), edges.max()], [-height, height], rtol=1e-14)


def test_error_rows_have_one_scale_that_drift_does_not_squash(run, figures):
    figure = figures["errors"]
    reach = np.abs(floats(of(run[0], "ekf"), "error_x_m")).max()
    for estimator, series in SERIES:
        top = column(figure, estimator, series)[0]
        assert reach < top.get_ylim()[1] < 3
        assert [text.get_text() for text in top.texts] == (
            ["leaves the frame"] if estimator == "dead-reckoning" else []
        )


def test_without_truth_the_errors_give_way_to_the_sigmas_that_are_claimed(run):
    figure = plots.plot_errors(without_truth(run)[0])
    assert "no truth" in figure.get_suptitle()
    titles = [axes.get_title() for axes in figure.axes[:2]]
    position, heading = (figure.axes[titles.index("smoothed") + 2 * row] for row in (0, 1))
    rows = of(run[0], "gtsam-isam2", "smoothed")
    sigma = np.sqrt(floats(rows, "cov_xx", "cov_yy").sum(axis=1))
    assert_allclose(line(position, "gtsam-isam2").get_ydata(), sigma)
    degrees = np.degrees(np.sqrt(floats(rows, "cov_tt")[:, 0]))
    assert_allclose(line(heading, "gtsam-isam2").get_ydata(), degrees)
    assert figure.axes[0].get_ylabel() == "own σ of position [m]"
    assert figure.axes[2].get_ylabel() == "own σ of heading [deg]"


# Consistency and time --------------------------------------------------------------------------


def test_nees_is_drawn_against_the_interval_of_one_pose(run, figures):
    figure = figures["consistency"]
    (panel,) = [a for a in figure.axes if a.get_title() == "NEES of the pose, online"]
    assert_array_equal(line(panel, "ekf").get_ydata(), of(run[0], "ekf")["nees"])
    bounds = [a.get_ydata()[0] for a in panel.lines if a.get_label() == "95 % interval"]
    assert_allclose(bounds, chi2.ppf([0.025, 0.975], 3))
    assert "almost one sample" in figure.get_suptitle()


def test_nis_is_drawn_against_the_interval_of_each_step(run, figures):
    figure = figures["consistency"]
    (panel,) = [a for a in figure.axes if a.get_title().endswith("ekf (online)")]
    rows = of(run[0], "ekf")
    time, nis, dof = floats(rows[rows["nis_dof"] > 0], "time_s", "nis", "nis_dof").T
    assert 0 < len(time) < STEPS  # some steps saw nothing
    (dots,) = with_color(panel.lines, "ekf")
    assert_allclose(points(dots), np.column_stack([time, nis / dof]))
    bounds = [points(a) for a in panel.lines if a.get_label() == "95 % interval"]
    for bound, tail in zip(bounds, (0.025, 0.975), strict=True):
        assert_allclose(bound, np.column_stack([time, chi2.ppf(tail, dof) / dof]))


def test_without_truth_there_is_nis_alone(run):
    figure = plots.plot_consistency(without_truth(run)[0])
    titles = [axes.get_title() for axes in figure.axes]
    assert titles == [f"NIS per degree of freedom, {name} (online)" for name in ("ekf", "mine")]
    assert "NEES" not in figure.get_suptitle()


@pytest.mark.parametrize(("spread", "scale"), [(1.0, "linear"), (1e5, "log")])
def test_nees_over_decades_has_a_logarithmic_axis(run, spread, scale):
    table = run[0].assign(nees=np.tile(np.linspace(1.0, 2.0, STEPS), len(SERIES)))
    table.loc[table["step"] == STEPS - 1, "nees"] *= spread
    assert plots.plot_consistency(table).axes[0].get_yscale() == scale


@pytest.mark.parametrize("shift", [1e-6, 1e4])
def test_the_interval_stays_in_view_when_the_nees_is_far_from_it(run, shift):
    panel = plots.plot_consistency(run[0].assign(nees=run[0]["nees"] * shift)).axes[0]
    bottom, top = panel.get_ylim()
    low, high = chi2.ppf([0.025, 0.975], 3)
    assert bottom < low < high < top


def test_time_per_step_is_in_microseconds_on_a_logarithmic_axis(run):
    table = run[0].copy()
    table.loc[table["step"] == 7, "time_step_s"] = 0.0  # the clock was too coarse
    (axes,) = plots.plot_times(table).axes
    expected = of(table, "ekf")["time_step_s"].to_numpy() * 1e6
    expected[7] = np.nan
    assert axes.get_yscale() == "log"
    assert_allclose(line(axes, "ekf").get_ydata(), expected)
    labels = [str(a.get_label()).partition(":")[0] for a in axes.lines]
    assert labels == ["ekf", "gtsam-isam2", "mine"]  # one each; dead reckoning has no times


# Style -----------------------------------------------------------------------------------------


def test_few_steps_and_times_close_together_have_axes_with_plain_numbers(run):
    short = of(run[0], "ekf")[:3].assign(time_step_s=[3.1e-6, 6.2e-6, 12e-6])
    figure = plots.plot_times(short)
    (axes,) = figure.axes
    FigureCanvasAgg(figure).draw()
    words = [label.get_text() for label in axes.get_yticklabels(which="both") if label.get_text()]
    assert {"4", "6", "10"} <= set(words)
    assert all(float(word) > 0 for word in words)  # and no power of ten
    assert all(place == int(place) for place in axes.get_xticks())


def test_an_estimator_has_one_colour_in_every_figure(figures):
    for estimator, series in [SERIES[0], SERIES[2], SERIES[4]]:
        (panel,) = [a for a in figures["consistency"].axes if f"pose, {series}" in a.get_title()]
        error = column(figures["errors"], estimator, series)[0]
        colors = {
            to_hex(line(figures["map"].axes[0], estimator).get_color()),
            to_hex(error.lines[-1].get_color()),
            to_hex(error.collections[0].get_facecolor()[0]),
            to_hex(line(panel, estimator).get_color()),
            to_hex(line(figures["times"].axes[0], estimator).get_color()),
        }
        assert colors == {plots.look(estimator).color.lower()}


@pytest.mark.parametrize("name", NAMES)
def test_nothing_global_is_touched(run, name):
    with matplotlib.rc_context({"font.size": 13, "pdf.fonttype": 3}):
        before = dict(matplotlib.rcParams)
        figure = draw(name, run)
        assert dict(matplotlib.rcParams) == before
    assert pyplot.get_fignums() == []
    assert figure.axes[0].xaxis.label.get_fontsize() == 8  # the style was in force


# Files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_saving_again_makes_the_same_files(figures, name, tmp_path):
    first, again = tmp_path / "first", tmp_path / "again"
    for folder in (first, again):
        folder.mkdir()
        paths = plots.save(figures[name], folder, "picture")
        assert paths == (folder / "picture.png", folder / "picture.pdf")
        assert sorted(folder.iterdir()) == sorted(paths)
    content = [path.read_bytes() for path in sorted(first.iterdir())]
    assert content[0].startswith(b"%PDF")
    assert b"/FontFile2" in content[0]  # TrueType: text stays text
    assert b"CreationDate" not in content[0]
    assert content[1].startswith(b"\x89PNG")
    assert [path.read_bytes() for path in sorted(again.iterdir())] == content


def test_the_figures_of_tables_read_from_csv_are_the_same(run, figures, tmp_path):
    paths = [tmp_path / "trajectories.csv", tmp_path / "landmarks.csv"]
    for table, path in zip(run, paths, strict=True):
        table.to_csv(path, index=False)
    read = [pd.read_csv(path) for path in paths]  # whole numbers with gaps become floats
    for name in NAMES:
        assert draw(name, read)._repr_png_() == figures[name]._repr_png_()


def test_saving_to_a_folder_that_is_not_there_is_an_input_error(figures, tmp_path):
    with pytest.raises(InputError, match="cannot write"):
        plots.save(figures["times"], tmp_path / "none", "picture")
    assert list(tmp_path.iterdir()) == []


def test_a_notebook_shows_the_figures(figures):
    assert PNGFormatter()(figures["map"]).startswith(b"\x89PNG")


# Tables that are empty, broken or of several runs ----------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_tables_without_rows_make_a_figure_that_says_so(name, tmp_path):
    empty = [tables.concat(table, []) for table in ("trajectories", "landmarks")]
    figure = draw(name, empty)
    plots.save(figure, tmp_path, name)
    said = figure.get_suptitle() + "".join(text.get_text() for text in figure.texts)
    assert "no" in said
    assert "to show" in said


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [np.nan, -1e9, 1e300])
def test_a_diverged_estimator_does_not_spoil_the_others(run, figures, name, value):
    broken = []
    for table in run:
        numeric = [c for c, dtype in tables.SCHEMAS["trajectories"].items() if dtype == "float64"]
        hurt = [c for c in numeric if c in table and c != "time_s" and not c.startswith("true")]
        table = table.reset_index(drop=True)
        late = table["step"] > 20 if "step" in table else table["landmark"] > 1
        table.loc[late & (table["estimator"] == "mine"), hurt] = value
        broken.append(table)
    figure = draw(name, broken)
    figure._repr_png_()  # warnings are errors
    if name in ("map", "errors"):
        assert_allclose(figure.axes[0].get_xlim(), figures[name].axes[0].get_xlim(), rtol=0.1)
        assert_allclose(figure.axes[0].get_ylim(), figures[name].axes[0].get_ylim(), rtol=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_an_estimator_that_is_lost_from_the_start_is_left_out(run, name):
    lost = []
    for table in run:
        real = [c for c in table if table[c].dtype == "float64" and c != "time_s"]
        table = table.reset_index(drop=True)
        table.loc[table["estimator"] == "mine", real] = np.nan
        lost.append(table)
    figure = draw(name, lost)
    color = plots.look("mine").color.lower()
    drawn = [a for axes in figure.axes for a in axes.lines if len(a.get_xdata())]
    assert color not in {to_hex(a.get_color()) for a in drawn}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("key", ["dataset", "seed"])
def test_several_runs_in_one_figure_are_an_input_error(run, name, key):
    other = "other" if key == "dataset" else 4
    mixed = [pd.concat([table, table.assign(**{key: other})]) for table in run]
    with pytest.raises(InputError, match="one dataset and seed"):
        draw(name, mixed)


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_column_is_an_input_error(run, name):
    lacking = {"map": "x_m", "errors": "cov_tt", "consistency": "nis", "times": "time_step_s"}
    with pytest.raises(InputError, match=f"no column {lacking[name]}"):
        draw(name, (run[0].drop(columns=lacking[name]), run[1]))
    with pytest.raises(InputError, match="no column seed"):
        draw(name, (run[0].drop(columns="seed"), run[1]))


def test_a_run_without_a_seed_has_a_title_without_one(run):
    recorded = [table.assign(seed=pd.NA) for table in run]
    assert plots.plot_times(run[0]).get_suptitle() == "ring, seed 3: time of each step"
    assert plots.plot_times(recorded[0]).get_suptitle() == "ring: time of each step"
    assert plots.plot_map(*recorded).get_suptitle() == "ring: map with 3σ ellipses"


def test_a_lost_filter_does_not_squash_the_nees_of_the_others(run):
    lost = of(run[0], "ekf").assign(estimator="lost", nees=10.0 ** np.linspace(0, 24, STEPS))
    figure = plots.plot_consistency(pd.concat([run[0], lost]))
    panel = figure.axes[0]
    assert panel.get_ylim()[1] < 1e3
    assert [text.get_text() for text in panel.texts] == ["lost: leaves the frame"]
    assert max(points(line(panel, "lost"))[:, 1]) < 1e5  # a vector file would carry them along
    (only,) = [a for a in plots.plot_consistency(lost).axes if "NEES" in a.get_title()]
    assert only.get_ylim()[1] > 1e24  # what is typical here
    assert not only.texts


def test_many_series_go_on_in_blocks_below(run):
    """All on one page, each with its three panels, on the scales of the whole figure."""
    many = [of(run[0], "ekf").assign(estimator=f"filter-{k}") for k in range(9)]
    figure = plots.plot_errors(pd.concat(many))
    assert figure.get_figwidth() == plots.PAGE
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 27
    assert len({axes.get_ylim() for axes in shown}) == 3
    titles = [axes.get_title() for axes in shown if axes.get_title()]
    assert titles == [f"filter-{k}\nonline" for k in range(9)]
    labelled = [axes for axes in shown if axes.get_xlabel()]
    assert len(labelled) == 9
    assert all(axes.get_xticklabels()[0].get_visible() for axes in labelled)


@pytest.mark.parametrize("name", NAMES)
def test_a_figure_fits_the_width_that_is_asked_for(run, name):
    """Also that of one column: its text keeps its size and stays inside."""
    plot = getattr(plots, f"plot_{name}")
    figure = plot(*(run if name == "map" else run[:1]), width=3.3)
    assert figure.get_figwidth() == 3.3
    FigureCanvasAgg(figure).draw()
    width, height = figure.bbox.size
    words = [figure._suptitle, *figure.legends, *(axes.xaxis.label for axes in figure.axes)]
    words += [axes.title for axes in figure.axes]
    for box in (each.get_window_extent() for each in words):
        assert -1 <= box.x0 <= box.x1 <= width + 1
        assert -1 <= box.y0 <= box.y1 <= height + 1


def test_the_title_says_of_whom_there_is_nothing_to_show(run):
    blind = without_truth(run)[0]
    for figure in (
        plots.plot_map(*run, absent={"mine": "failed"}),
        plots.plot_errors(run[0], absent={"mine": "failed"}),
        plots.plot_errors(blind, absent={"mine": "failed"}),
        plots.plot_consistency(run[0], absent={"mine": "failed"}),
        plots.plot_times(run[0].assign(time_step_s=1e-3), absent={"mine": "failed"}),
    ):
        assert figure.get_suptitle().endswith("\nnothing to show of mine (failed)")
    assert "nothing" not in plots.plot_errors(run[0]).get_suptitle()


@pytest.mark.parametrize("name", NAMES)
def test_looks_do_not_depend_on_who_has_failed(run, name):
    """Own filters whose first choice is the same look: one of them gives way."""
    alike = [f"mine:Filter{number}" for number in range(100)]
    alike = [each for each in alike if plots.look(each) == plots.look(alike[0])][:3]
    first, second, third = alike
    both = plots.looks(alike)
    assert both[second] != plots.look(second)
    assert plots.looks([third, second, first]) == both
    plot = getattr(plots, f"plot_{name}")
    renamed = [table.assign(estimator=second, time_step_s=1e-3) for table in run]
    figure = plot(
        *(renamed if name == "map" else renamed[:1]), absent={third: "failed", first: "skipped"}
    )
    drawn = [artist.get_color() for axes in figure.axes for artist in axes.lines]
    assert both[second].color in drawn
    assert both[first].color not in drawn


# Several robots --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def team(run):
    """The run once more, with a second robot that does the same twenty metres aside."""
    trajectories, landmarks = run
    aside = {c: trajectories[c] + 20 for c in ("x_m", "true_x_m")}
    aside |= {c: 2 * trajectories[c] for c in ("error_x_m", "nees")}
    both = [trajectories.assign(robot="one"), trajectories.assign(robot="two", **aside)]
    # By estimator, as tables are stacked.
    stacked = pd.concat(both).sort_values("estimator", kind="stable", ignore_index=True)
    return stacked, landmarks.assign(robot=pd.NA)


def of_robot(table, robot):
    return table[table["robot"] == robot]


def test_the_map_shows_the_path_of_each_robot_and_the_map_once(team):
    trajectories, landmarks = team
    figure = plots.plot_map(*team)
    (axes,) = figure.axes
    mine = with_color(axes.lines, "ekf")
    paths = [points(artist) for artist in mine if artist.get_linestyle() == "-"]
    for path, robot in zip(paths, ("one", "two"), strict=True):
        assert_array_equal(path, floats(of(of_robot(trajectories, robot), "ekf"), "x_m", "y_m"))
    drawn = [a for a in axes.lines if len(a.get_xdata()) == STEPS]
    truths = [points(a) for a in drawn if a.get_color() == TRUTH]
    assert len(truths) == 2
    assert_array_equal(truths[1], truths[0] + [20, 0])
    assert legend(figure).count("ekf (online)") == legend(figure).count("truth") == 1
    assert points(line(axes, "start")).shape[0] == 2 * (4 + 1)  # of four estimators and the truth
    ellipses = [c for c in axes.collections if isinstance(c, LineCollection)]
    color = plots.look("ekf").color.lower()
    (ours,) = [c for c in ellipses if to_hex(c.get_edgecolor()[0]) == color]
    assert len(ours.get_segments()) == len(LANDMARKS) + 2
    assert_array_equal(
        [points(a) for a in mine if len(a.get_xdata()) == len(LANDMARKS)],
        [floats(of(landmarks, "ekf"), "x_m", "y_m")],
    )


def test_the_map_names_robots_where_they_start(run, team):
    assert not plots.plot_map(*run).axes[0].texts
    for both in (team, without_truth(team)):
        first, second = plots.plot_map(*both).axes[0].texts
        assert (first.get_text(), second.get_text()) == ("one", "two")
        assert_allclose(np.subtract(second.xy, first.xy), [20, 0])


@pytest.mark.parametrize("name", ["errors", "consistency"])
def test_errors_are_of_one_robot_at_a_time(team, name):
    trajectories = team[0]
    plot = getattr(plots, f"plot_{name}")
    for robot in ("one", "two"):
        alone = plot(of_robot(trajectories, robot))
        figure = plot(trajectories, robot=robot)
        assert f"ring, seed 3, {robot}" in figure.get_suptitle()
        assert f", {robot}" not in alone.get_suptitle()
        for panel, expected in zip(figure.axes, alone.axes, strict=True):
            for mine, theirs in zip(panel.lines, expected.lines, strict=True):
                assert_array_equal(points(mine), points(theirs))
    assert plot(trajectories)._repr_png_() == plot(trajectories, robot="one")._repr_png_()
    with pytest.raises(UnknownNameError, match="'three'"):
        plot(trajectories, robot="three")


def test_times_are_shown_once(team, figures):
    figure = plots.plot_times(team[0])
    for curve, expected in zip(
        sorted(figure.axes[0].lines, key=lambda a: a.get_label()),
        sorted(figures["times"].axes[0].lines, key=lambda a: a.get_label()),
        strict=True,
    ):
        assert_array_equal(points(curve), points(expected))


def test_a_robot_without_a_path_is_left_out_of_the_map(team):
    trajectories = team[0].copy()
    trajectories.loc[trajectories["robot"] == "one", ["x_m", "true_x_m"]] = np.nan
    (axes,) = plots.plot_map(trajectories, team[1]).axes
    assert_array_equal(
        points(line(axes, "ekf (online)")),
        floats(of(of_robot(trajectories, "two"), "ekf"), "x_m", "y_m"),
    )
