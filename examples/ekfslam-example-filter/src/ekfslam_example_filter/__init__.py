"""Mapping along dead reckoning: how far one gets without a filter."""

from __future__ import annotations

from typing import Any

import numpy as np


class MeanMap:
    """Dead reckoning, and every landmark the mean of where it was seen from there.

    Parameters
    ----------
    prior : ekfslam.Prior
        Of the first pose.
    last : int, optional
        How many sightings count, from the last one back; all by default.
    """

    kinds = ("range-bearing",)

    def __init__(self, prior: Any, last: int | None = None) -> None:
        self.pose = np.array(prior.mean)
        self.last = last
        self.seen: dict[int, list[np.ndarray]] = {}

    def predict(self, increment: np.ndarray, covariance: np.ndarray) -> None:
        """Move by an increment in the frame of the robot; its noise is not looked at."""
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        self.pose += [*np.array([[c, -s], [s, c]]) @ increment[:2], increment[2]]

    def observe(self, observations: Any) -> None:
        """Put every sighting down where it seems to be."""
        for landmark, (distance, bearing) in zip(
            observations.landmark.tolist(), observations.values, strict=True
        ):
            angle = self.pose[2] + bearing
            place = self.pose[:2] + distance * np.array([np.cos(angle), np.sin(angle)])
            self.seen.setdefault(landmark, []).append(place)

    @property
    def landmarks(self) -> dict[int, np.ndarray]:
        """Position of each landmark by its identity."""
        recent = slice(None if self.last is None else -self.last, None)
        return {name: np.mean(places[recent], axis=0) for name, places in self.seen.items()}
