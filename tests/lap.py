"""Tables of a lap that nobody has estimated, and what is found in figures of it."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.colors import to_hex

from ekfslam import plots
from ekfslam.evaluation import tables

STEPS = 60
RUN = {"dataset": "ring", "seed": 3, "robot": "robot"}
SERIES = [
    ("ekf", "online"),
    ("gtsam-isam2", "online"),
    ("gtsam-isam2", "smoothed"),
    ("dead-reckoning", "online"),
    ("mine", "online"),
]
LANDMARKS = np.array([[0.0, 14.0], [14.0, 0.0], [-14.0, 0.0], [0.0, -14.0]])


def covariances(rng, count, size):
    root = rng.normal(scale=0.1, size=(count, size, size))
    return root @ np.swapaxes(root, 1, 2)


def columns(names, values):
    return dict(zip(names.split(), np.asarray(values).T, strict=True))


def trajectory(rng, estimator, series):
    """A lap on a circle of 10 m; dead reckoning drifts 100 m away."""
    angle = np.linspace(0, 6, STEPS)
    truth = np.column_stack([10 * np.cos(angle), 10 * np.sin(angle), angle - 3])
    error = rng.normal(scale=0.1, size=(STEPS, 3))
    if estimator == "dead-reckoning":
        error += np.linspace(0, 100, STEPS)[:, None] * [1, 0, 0.01]
    i, j = np.triu_indices(3)
    covariance = covariances(rng, STEPS, 3)[:, i, j]
    rows = RUN | {"estimator": estimator, "series": series, "step": np.arange(STEPS)}
    rows |= {"time_s": 0.5 * np.arange(STEPS), "nees": rng.chisquare(3, STEPS)}
    rows |= columns("x_m y_m theta_rad", truth + error)
    rows |= columns("true_x_m true_y_m true_theta_rad", truth)
    rows |= columns("error_x_m error_y_m error_theta_rad", error)
    rows |= columns("cov_xx cov_xy cov_xt cov_yy cov_yt cov_tt", covariance)
    if estimator in ("ekf", "mine"):
        dof = rng.integers(0, 4, STEPS) * 2
        nis = np.where(dof > 0, rng.chisquare(np.maximum(dof, 1)), np.nan)
        rows |= {"nis": nis, "nis_dof": dof}
    if estimator != "dead-reckoning":
        rows |= {"time_step_s": rng.uniform(1e-6, 1e-3, STEPS)}
    return pd.DataFrame(rows)


def landmark_rows(rng, estimator, series):
    positions = LANDMARKS + rng.normal(scale=0.1, size=(4, 2))
    covariance = covariances(rng, 4, 2)[:, [0, 0, 1], [0, 1, 1]]
    rows = RUN | {"estimator": estimator, "series": series, "landmark": np.arange(4)}
    rows |= columns("x_m y_m", positions) | columns("true_x_m true_y_m", LANDMARKS)
    return pd.DataFrame(rows | columns("cov_xx cov_xy cov_yy", covariance))


def typed(name, frames):
    schema = tables.SCHEMAS[name]
    return pd.concat(frames).reindex(columns=list(schema)).astype(dict(schema))


def ring():
    """Tables `trajectories` and `landmarks` of one run."""
    rng = np.random.default_rng(20240607)
    mappers = [pair for pair in SERIES if pair[0] != "dead-reckoning"]
    return (
        typed("trajectories", [trajectory(rng, *pair) for pair in SERIES]),
        typed("landmarks", [landmark_rows(rng, *pair) for pair in mappers]),
    )


def without_truth(run):
    columns = ["true_", "error_", "nees"]
    return tuple(
        table.assign(**{c: np.nan for c in table if c.startswith(tuple(columns))}) for table in run
    )


def of(table, estimator, series="online"):
    return table[(table["estimator"] == estimator) & (table["series"] == series)]


def floats(rows, *names):
    return np.column_stack([rows[name].to_numpy(float, na_value=np.nan) for name in names])


def line(axes, label):
    (found,) = [artist for artist in axes.lines if str(artist.get_label()).startswith(label)]
    return found


def points(artist):
    return np.column_stack(artist.get_data()).astype(float)


def with_color(artists, estimator):
    return [a for a in artists if to_hex(a.get_color()) == plots.look(estimator).color.lower()]


def legend(figure):
    return [text.get_text().replace("\n", " ") for text in figure.legends[0].get_texts()]
