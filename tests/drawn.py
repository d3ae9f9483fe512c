"""Tables of campaigns drawn at random, as if estimators had made them."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ekfslam.evaluation.consistency import squared_mahalanobis
from ekfslam.evaluation.run_metrics import RUN_METRICS
from ekfslam.evaluation.schema import SCHEMAS

KEYS = {
    "scenario": "string",
    "seed": "Int64",
    "robot": "string",
    "estimator": "string",
    "series": "string",
    "status": "string",
}
COLUMNS = (
    KEYS
    | {
        name: dtype
        for name, dtype in SCHEMAS["summary"].items()
        if name not in (*KEYS, "dataset", "message") and not name.startswith("time_")
    }
    | dict(RUN_METRICS)
)


def runs_of(seeds, estimator="ekf", **columns):
    """Rows of the table `runs`, empty but for what is given."""
    count = len(seeds)
    given = {
        "scenario": "loop",
        "seed": np.asarray(seeds),
        "robot": "robot",
        "estimator": estimator,
        "series": "online",
        "status": "ok",
    } | columns
    table = {
        name: pd.Series(given.pop(name, None), index=range(count), dtype=dtype)
        for name, dtype in COLUMNS.items()
    }
    assert not given, f"no columns of runs: {given}"
    return pd.DataFrame(table)


def steps_of(rng, seeds, steps=(5, 10), claimed=1.0, estimator="ekf", **keys):
    """Rows of the table `steps`: errors of a covariance that is `claimed` times as large."""
    count = len(seeds) * len(steps)
    factor = rng.normal(size=(3, 3)) + 2 * np.eye(3)
    covariance = factor @ factor.T * 1e-3
    errors = rng.multivariate_normal(np.zeros(3), covariance, count)
    covariances = np.tile(claimed * covariance, (count, 1, 1))
    nees = squared_mahalanobis(errors, covariances)
    columns = {
        "scenario": "loop",
        "seed": np.repeat(seeds, len(steps)),
        "robot": "robot",
        "estimator": estimator,
        "series": "online",
        "step": np.tile(steps, len(seeds)),
        "time_s": 0.5 * np.tile(steps, len(seeds)),
        "nees": nees,
        "nees_invariant": 1.1 * nees,
    } | keys
    columns |= dict(zip(("error_x_m", "error_y_m", "error_theta_rad"), errors.T, strict=True))
    i, j = np.triu_indices(3)
    names = [f"cov_{a}" for a in ("xx", "xy", "xt", "yy", "yt", "tt")]
    columns |= dict(zip(names, covariances[:, i, j].T, strict=True))
    dtypes = SCHEMAS["trajectories"] | KEYS
    return pd.DataFrame(columns).astype({name: dtypes[name] for name in columns})
