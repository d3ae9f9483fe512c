"""Identities of landmarks, withheld from the estimators and kept for the evaluation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numerics import assert_same_record
from numpy.testing import assert_array_equal


def test_identities_can_be_withheld(full_dataset):
    hidden = full_dataset.without_identities()
    assert_array_equal(hidden.observations.landmark, np.full(5, -1))
    assert_array_equal(hidden.sightings.landmark, np.full(5, -1))
    assert_array_equal(hidden.true_landmark, full_dataset.true_landmark)
    assert_array_equal(full_dataset.observations.landmark, [7, 7, 9, -1, 12])
    for name in ("step", "values", "sensor", "time", "covariance", "descriptor"):
        assert_array_equal(
            getattr(hidden.observations, name), getattr(full_dataset.observations, name)
        )
    assert not hidden.association_known
    assert_same_record(hidden.without_identities(), hidden)


def test_identities_that_are_all_known_become_the_truth(full_dataset):
    whole = replace(full_dataset.observations, landmark=[7, 7, 9, 7, 12])
    known = replace(full_dataset, observations=whole, true_landmark=None)
    assert known.without_identities().true_landmark.tolist() == [7, 7, 9, 7, 12]
    partly = replace(full_dataset, true_landmark=None)
    assert partly.without_identities().true_landmark is None
