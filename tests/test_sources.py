"""Datasets by name, with values of a scenario set where it is named."""

from importlib.resources import files

import numpy as np
import pytest

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.experiments import compare
from ekfslam.experiments.sources import open_dataset
from ekfslam.simulation import load_scenario, simulate


def test_values_of_scenarios_in_names():
    """Dotted keys, as for `load_scenario`; the dataset is called by what was asked for."""
    name = "park(path.laps=1, sensors.0.max_range=6)"
    dataset = open_dataset(name, seed=3)
    changes = {"path.laps": 1, "sensors.0.max_range": 6}
    expected = simulate(load_scenario("park", changes), seed=3)
    assert dataset.name == name
    np.testing.assert_array_equal(dataset.observations.values, expected.observations.values)
    assert len(dataset.observations) < len(open_dataset("park", seed=3).observations)
    drawn = simulate(name, seed=3)
    np.testing.assert_array_equal(drawn.observations.values, dataset.observations.values)
    assert load_scenario(name, {"path.laps": 2}).name == name
    with pytest.raises(InputError, match=r"laps"):
        open_dataset("park(path.lapse=1)")
    with pytest.raises(UnknownNameError, match="parc"):
        open_dataset("parc(path.laps=1)")
    with pytest.raises(InputError, match="bracket"):
        load_scenario("park(path.laps=1")
    with pytest.raises(UnknownNameError):
        load_scenario("park)")


def test_a_file_may_have_brackets_in_its_path(tmp_path):
    folder = tmp_path / "of mine (old)"
    folder.mkdir()
    file = folder / "short(er).toml"
    file.write_text((files("ekfslam.simulation") / "scenarios" / "loop-15.toml").read_text())
    assert load_scenario(file).name == load_scenario(str(file)).name == "short(er)"


def test_a_city_of_a_size_goes_through_all_of_it(tmp_path):
    """Simulation, filters on the whole and on a local map, smoother, tables, files and figures."""
    name = "city(world.count=80, path.steps=150)"
    estimators = ["ekf", "ekf-compressed(area=10)", "gtsam-isam2", "gtsam-batch"]
    found = compare(name, estimators)
    assert set(found.summary.status) == {"ok"}
    online = found.summary[found.summary.series == "online"].set_index("estimator")
    one, other = online.loc["ekf"], online.loc["ekf-compressed(area=10)"]
    for column in ("ate_position_rmse_m", "landmark_rmse_m", "nees_pose_mean", "nis_per_dof"):
        assert other[column] == pytest.approx(one[column], rel=1e-6)
    found.save(tmp_path)
    files = {path.name for path in tmp_path.iterdir()}
    assert {"summary.csv", "city-world.count-80-path.steps-150-map.pdf"} <= files
