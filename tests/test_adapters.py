"""Filters and functions of a user's own: the same numbers as estimators, and errors that help."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from made import make, pair
from own_filters import Reckoning, State, known

import ekfslam
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import Estimate
from ekfslam.experiments.attempts import attempt
from ekfslam.experiments.compare import compare
from ekfslam.registry import estimator_name, resolve
from ekfslam.simulation import simulate


def assert_same(estimate, expected):
    """The same numbers to the last bit, landmarks in whatever order."""
    for name in ("poses", "covariances"):
        pair = getattr(estimate.online, name), getattr(expected.online, name)
        np.testing.assert_array_equal(*pair)
    order = np.argsort(estimate.landmarks.ids)
    for name in ("ids", "positions", "covariances"):
        column = getattr(estimate.landmarks, name)[order]
        np.testing.assert_array_equal(column, getattr(expected.landmarks, name))
    for name in ("decision", "landmark", "innovation", "S"):
        columns = getattr(estimate.innovations, name), getattr(expected.innovations, name)
        np.testing.assert_array_equal(*columns)
    np.testing.assert_array_equal(estimate.step_dof, expected.step_dof)
    np.testing.assert_allclose(estimate.step_nis, expected.step_nis, rtol=1e-13)


# Laws ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("update", ["joint", "sequential"])
@pytest.mark.parametrize("scenario", ["loop-15", "park"])
def test_the_filter_step_by_step_is_the_estimator(scenario, update):
    dataset = simulate(scenario, seed=3)
    expected = resolve("ekf", update=update).estimate(dataset)
    of_a_class = resolve(ekfslam.EkfSlam, update=update).estimate(dataset)
    assert_same(of_a_class, expected)
    assert of_a_class.options == {"update": update}
    of_an_object = resolve(ekfslam.EkfSlam(prior=dataset.prior, update=update)).estimate(dataset)
    assert_same(of_an_object, expected)


def test_so_it_is_where_it_associates_by_itself():
    dataset = simulate("loop-15", seed=3).without_identities()
    expected = resolve("ekf", association="nearest").estimate(dataset)
    estimate = resolve(ekfslam.EkfSlam, association="nearest").estimate(dataset)
    assert estimate.association == "nearest"
    assert_same(estimate, expected)


def test_without_the_joint_nis_that_of_a_step_is_the_sum_over_its_observations():
    """Exact if they correct one after another, where each S is that after the ones before."""

    class Silent(ekfslam.EkfSlam):
        nis = None

    dataset = simulate("loop-15", seed=3)
    expected = resolve("ekf", update="sequential").estimate(dataset)
    estimate = resolve(Silent, update="sequential").estimate(dataset)
    np.testing.assert_array_equal(estimate.step_dof, expected.step_dof)
    np.testing.assert_allclose(estimate.step_nis, expected.step_nis, rtol=1e-9)


def test_dead_reckoning_as_a_filter_and_as_a_function():
    dataset = simulate("cloister", seed=2)
    expected = resolve("dead-reckoning").estimate(dataset).online

    def poses(dataset):
        return expected.poses

    def both(dataset):
        return expected.poses, expected.covariances

    for source in (Reckoning, Reckoning(dataset.prior), lambda: Reckoning(dataset.prior)):
        estimate = resolve(source).estimate(dataset)
        np.testing.assert_allclose(estimate.online.poses, expected.poses, atol=1e-12)
        assert estimate.online.covariances is None
        assert estimate.landmarks is None
        assert estimate.innovations is None
        assert estimate.message == ""
    np.testing.assert_array_equal(resolve(poses).estimate(dataset).online.poses, expected.poses)
    found = resolve(both).estimate(dataset).online
    np.testing.assert_array_equal(found.covariances, expected.covariances)


def test_runs_do_not_know_of_each_other():
    """A class is made anew, an object copied: the second run is as the first one."""
    dataset = simulate("cloister", seed=2)
    for source in (Reckoning, Reckoning(dataset.prior)):
        subject = resolve(source)
        first, second = subject.estimate(dataset), subject.estimate(dataset)
        np.testing.assert_array_equal(first.online.poses, second.online.poses)
    kept = Reckoning(dataset.prior)
    resolve(kept).estimate(dataset)
    np.testing.assert_array_equal(kept.pose, dataset.prior.mean)


def test_what_a_filter_changes_later_does_not_change_what_was_read():
    """`Reckoning` has one array for all its poses."""
    poses = resolve(Reckoning).estimate(simulate("cloister", seed=2)).online.poses
    assert len(np.unique(poses[:, 0])) > 100


def test_a_heading_is_wrapped():
    class Turning(Reckoning):
        def predict(self, increment, covariance):
            self.pose = self.pose + np.array([0, 0, 4 * np.pi + increment[2]])

    poses = resolve(Turning).estimate(known()).online.poses
    np.testing.assert_allclose(poses, 0, atol=1e-12)


# Names and options --------------------------------------------------------------------------------


def test_options_reach_the_filter_and_the_function():
    def slow(dataset, speed=1.0):
        return resolve(Reckoning, speed=speed).estimate(dataset)

    dataset = known()
    half = [[0, 0, 0], [0.5, 0, 0], [1, 0, 0]]
    for source in (Reckoning, slow, partial(Reckoning, speed=0.5), partial(slow, speed=0.5)):
        options = {} if isinstance(source, partial) else {"speed": 0.5}
        estimate = resolve(source, **options).estimate(dataset)
        np.testing.assert_allclose(estimate.online.poses, half)
    with pytest.raises(UnknownNameError, match="unknown option of Reckoning 'sped'; did you mean"):
        resolve(Reckoning, sped=0.5)
    with pytest.raises(InputError, match="options speed are for a name or a class"):
        resolve(Reckoning(), speed=0.5)


def test_a_function_with_a_prior_makes_a_filter_for_every_dataset():
    def still(prior):
        return Reckoning(prior, speed=0.0)

    def nothing(prior):
        return None

    dataset = simulate("cloister", seed=2)
    poses = resolve(still).estimate(dataset).online.poses
    np.testing.assert_array_equal(poses, np.tile(dataset.prior.mean, (201, 1)))
    with pytest.raises(InputError, match="nothing made None, which has no predict and observe"):
        resolve(nothing).estimate(dataset)


def test_names_in_tables():
    def mine(dataset):
        return None

    class Named(Reckoning):
        name = "named"

    assert estimator_name(mine) == "mine"
    assert estimator_name(partial(mine, speed=3)) == "mine"
    assert estimator_name(partial(Reckoning)) == "Reckoning"
    for each in (Named, Named()):
        assert estimator_name(each) == "named"
        assert resolve(each).estimate(known()).estimator == "named"
    names = compare([known()], [Reckoning, Named, State()]).summary["estimator"]
    assert list(names) == ["Reckoning", "named", "State"]


@pytest.mark.parametrize(
    "calls", [{"predict": len}, {"observe": len}, {"predict": 1, "observe": 2}]
)
def test_what_is_no_filter(calls):
    with pytest.raises(InputError, match=r"no estimator: .* nor both predict.* and observe"):
        resolve(type("Half", (), calls)())


def test_constructors_that_ask_for_more():
    class Asking(Reckoning):
        def __init__(self, x0):
            pass

    with pytest.raises(InputError, match="cannot make Asking: missing a required argument: 'x0'"):
        resolve(Asking)
    with pytest.raises(InputError, match=r"cannot make <lambda>: .*missing 2 required"):
        resolve(lambda first, second: None)


# What it is for -----------------------------------------------------------------------------------


def status_of(source, dataset):
    row = compare([dataset], [source]).summary.iloc[0]
    return row["status"], row["message"]


def test_what_a_filter_is_not_for_is_skipped():
    class Ranging(Reckoning):
        kinds = "range"

    class Finding(Reckoning):
        association = "mine"

    status, message = status_of(Reckoning, make())
    assert status == "skipped"
    assert message.startswith("Reckoning needs known identities, which made does not have")
    assert status_of(Finding, make())[0] == "ok"
    assert resolve(Finding).estimate(make()).association == "mine"
    assert status_of(Reckoning, known())[0] == "ok"
    assert status_of(Ranging, known()) == (
        "skipped",
        "Ranging is for range, but laser reports range-bearing",
    )
    assert status_of(Reckoning, pair()) == ("skipped", "made has 2 robots; this is for one")
    Ranging.kinds = ("range", "bearings")
    with pytest.raises(UnknownNameError, match=r"view in Ranging.kinds 'bearings'; did you mean"):
        resolve(Ranging).estimate(known())
    Ranging.kinds = ("range", "range-bearing")
    assert status_of(Ranging, known())[0] == "ok"


def test_a_filter_may_refuse_by_itself():
    class Choosy(Reckoning):
        def observe(self, observations):
            raise UnsupportedError("not on a Sunday")

    assert status_of(Choosy, known()) == ("skipped", "not on a Sunday")


# Errors of its own --------------------------------------------------------------------------------


class Failing(Reckoning):
    """Fails in the third step, in a function of its own that calls one of a library."""

    steps = 0

    def observe(self, observations):
        self.steps += 1
        if self.steps > 2:
            self.invert()

    def invert(self):
        np.linalg.inv(np.zeros((2, 2)))


def line_of(text):
    lines = Path(__file__).read_text().splitlines()
    return 1 + next(i for i, line in enumerate(lines) if text in line)


def test_an_error_in_a_filter_names_file_line_and_step():
    status, message = status_of(Failing, known())
    assert status == "failed"
    place = (
        rf"{re.escape(Path(__file__).name)}, line {line_of('np.linalg.inv(np.zeros')}, in invert"
    )
    assert re.fullmatch(rf"LinAlgError: Singular matrix \(.*{place}, at step 2\)", message)
    with pytest.raises(np.linalg.LinAlgError):  # of its own type, for whoever calls it from Python
        resolve(Failing).estimate(known())


def test_so_it_does_in_a_property_a_constructor_and_an_estimator():
    class Held(State):
        @property
        def covariance(self):
            return self.absent["property"]

    class Made(Reckoning):
        def __init__(self):
            raise KeyError("constructor")

    class Whole:
        def estimate(self, dataset):
            raise KeyError("estimator")

    def function(dataset):
        raise KeyError("function")

    for source in (Held, Made, Whole, function):
        estimate = attempt("mine", resolve(source), known(), lambda *_: None)
        assert estimate.status == "failed"
        assert re.search(r"\((test_adapters|own_filters).py, line \d+, in \w+", estimate.message)
        assert "\n" not in estimate.message


def test_data_cannot_be_changed_from_inside():
    class Changing(Reckoning):
        def observe(self, observations):
            observations.values[:] = 0

    assert "read-only" in status_of(Changing, known())[1]


def test_an_object_that_cannot_be_copied():
    subject = Reckoning()
    subject.steps = (step for step in range(3))
    with pytest.raises(InputError, match=r"cannot copy Reckoning .*give its class"):
        resolve(subject).estimate(known())


def test_interrupts_are_not_caught():
    class Stopped(Reckoning):
        def observe(self, observations):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        status_of(Stopped, known())


# Functions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (None, r"function returned nothing: it must return an Estimate, poses \(3, 3\), or"),
        (np.zeros((2, 3)), r"poses that function returned must have shape \(3, 3\), got \(2, 3\)"),
        (np.full((3, 3), np.nan), "poses that function returned holds NaN"),
        (
            (np.zeros((3, 3)), np.eye(3)),
            r"covariances that function returned must have shape \(3, 3, 3\)",
        ),
    ],
)
def test_what_a_function_returns_must_be_what_is_expected(answer, message):
    def function(dataset):
        return answer

    with pytest.raises(InputError, match=message):
        resolve(function).estimate(known())


def test_a_function_of_poses_is_for_one_robot():
    with pytest.raises(UnsupportedError, match="2 robots"):
        resolve(lambda dataset: np.zeros((3, 3))).estimate(pair())


def test_a_function_may_return_an_estimate():
    def silent(dataset):
        return Estimate("other", dataset.name)

    def timed(dataset):
        return replace(silent(dataset), time_total=3.0)

    assert resolve(timed).estimate(known()).time_total == 3.0
    assert resolve(silent).estimate(known()).time_total < 3.0


# Times --------------------------------------------------------------------------------------------


def test_times_are_those_of_the_filter():
    estimate = resolve(ekfslam.EkfSlam).estimate(simulate("cloister", seed=2))
    assert (estimate.step_seconds > 0).all()
    assert estimate.time_total >= estimate.step_seconds.sum()
    assert estimate.time_marginals == 0.0


def test_progress_comes_to_an_end():
    done = []
    resolve(Reckoning).estimate(simulate("cloister", seed=2), progress=lambda *a: done.append(a))
    assert done[-1] == (201, 201)
    assert len(done) <= 102
