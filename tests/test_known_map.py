"""The map that a simulated dataset knows, for those who localize on it."""

from dataclasses import replace

import numpy as np
import pytest

from ekfslam.errors import InputError
from ekfslam.experiments import compare
from ekfslam.simulation import load_scenario, scenario_hash, simulate


def test_the_whole_world_is_known_to_those_who_localize():
    data = simulate("cloister", seed=1)
    assert data.known_map is data.true_map


def test_a_share_of_the_map_is_known_and_draws_nothing_else():
    scenario = load_scenario("cloister", {"known_map": 0.5})
    data, whole = simulate(scenario, seed=1), simulate("cloister", seed=1)
    known = data.known_map
    assert len(known) == len(data.true_map) // 2
    assert (np.diff(known.ids) > 0).all()
    rows = np.searchsorted(data.true_map.ids, known.ids)
    np.testing.assert_array_equal(known.positions, data.true_map.positions[rows])
    np.testing.assert_array_equal(data.observations.values, whole.observations.values)
    np.testing.assert_array_equal(data.robot.controls, whole.robot.controls)
    again, other = simulate(scenario, seed=1), simulate(scenario, seed=2)
    np.testing.assert_array_equal(again.known_map.ids, known.ids)
    assert not np.array_equal(other.known_map.ids, known.ids)
    assert "0.5 of the map known" in scenario.describe()


def test_a_map_may_be_withheld():
    assert simulate(load_scenario("cloister", {"known_map": 0.0}), seed=1).known_map is None


def test_scenarios_from_before_known_maps_keep_their_digests():
    park = load_scenario("park")
    assert scenario_hash(park)[:16] == "1fddf0fba37e9cbf"
    assert scenario_hash(replace(park, known_map=0.5)) != scenario_hash(park)


def test_a_share_is_between_nothing_and_all():
    for share in (-0.1, 1.1, float("nan")):
        with pytest.raises(InputError, match="known_map must be a share from 0 to 1"):
            load_scenario("cloister", {"known_map": share})


def test_localizers_and_who_makes_a_map_compare_side_by_side():
    names = ["ekf-localization", "gtsam-localization", "gtsam-localization(method=isam2)", "ekf"]
    summary = compare("cloister", names, seed=1).summary
    assert (summary["status"] == "ok").all(), summary["message"].tolist()
    assert summary["series"].tolist() == ["online", "smoothed", "online", "smoothed", "online"]
    assert summary["landmark_rmse_m"].notna().tolist() == [False] * 4 + [True]
    errors = summary["ate_position_rmse_m"]
    assert (errors[:4] < errors[4]).all()  # who knows the map knows more


def test_localizers_are_skipped_where_no_map_is_known():
    data = simulate(load_scenario("cloister", {"known_map": 0.0}), seed=1)
    summary = compare(data, ["ekf-localization", "gtsam-localization"]).summary
    assert summary["status"].tolist() == ["skipped", "skipped"]
    assert summary["message"].str.startswith("cloister has no known map to localize on").all()


def test_a_known_map_changes_nothing_for_who_makes_a_map_of_their_own():
    known = simulate(load_scenario("orchard", {"path.spacing": 2.0}), seed=1)
    names = ["ekf(association=nearest)", "gtsam-isam2", "dead-reckoning"]
    tables = [
        compare(data.without_identities(), names)
        for data in (known, replace(known, known_map=None))
    ]
    for one, other in zip(
        *([t.summary, t.landmarks, t.innovations, t.association] for t in tables), strict=True
    ):
        timed = [name for name in one if name.startswith("time_")]
        assert one.drop(columns=timed).equals(other.drop(columns=timed))
