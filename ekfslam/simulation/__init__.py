"""Simulated datasets: worlds, paths and scenarios by name or from a TOML file."""

from ekfslam.simulation.plans import RobotPlan, SensorPlan
from ekfslam.simulation.reading import describe_scenario, load_scenario, scenarios
from ekfslam.simulation.scenario import Scenario
from ekfslam.simulation.simulate import simulate
from ekfslam.simulation.variants import scenario_hash

__all__ = [
    "RobotPlan",
    "Scenario",
    "SensorPlan",
    "describe_scenario",
    "load_scenario",
    "scenario_hash",
    "scenarios",
    "simulate",
]
