"""Filters that hold and tell what a test wants, and data for them."""

from __future__ import annotations

import numpy as np
from made import make

from ekfslam.geometry import compose


def known(**columns):
    """Two steps straight ahead and one sighting of landmark 4, unless told otherwise."""
    return make(**{"landmark": [4], **columns})


class Reckoning:
    """Dead reckoning as a filter: the least that is asked of one."""

    def __init__(self, prior=None, speed=1.0):
        self.pose = np.zeros(3) if prior is None else np.array(prior.mean)
        self.speed = speed

    def predict(self, increment, covariance):
        self.pose[:] = compose(self.pose, self.speed * increment)

    def observe(self, observations):
        pass


class State(Reckoning):
    """A filter with a state that grows, and whatever else a test gives it."""

    def __init__(self, prior=None, **changes):
        super().__init__(prior)
        self.seen, self.changes = {}, changes
        self.pose = changes.get("pose", self.pose)

    def predict(self, increment, covariance):
        pass

    def observe(self, observations):
        for landmark, value in zip(observations.landmark, observations.values, strict=True):
            self.seen.setdefault(int(landmark), value)

    def __getattr__(self, name):
        if name in self.__dict__.get("changes", ()):
            return self.changes[name]
        if name == "mean":
            return np.concatenate([self.pose, *self.seen.values()])
        if name == "ids":
            return list(self.seen)
        raise AttributeError(name)
