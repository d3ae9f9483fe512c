"""Simulated datasets: worlds, paths and scenarios by name or from a TOML file."""

from ekfslam.simulation.scenario import Scenario, load_scenario, scenarios
from ekfslam.simulation.simulate import simulate

__all__ = ["Scenario", "load_scenario", "scenarios", "simulate"]
