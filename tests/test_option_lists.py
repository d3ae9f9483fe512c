"""`ekfslam estimators NAME`: every option, with what the docstrings say of it."""

import inspect
import json

import pytest

from ekfslam.cli.docstrings import Told, options_of
from ekfslam.registry import named, registered, resolve


class Base:
    """A base.

    Parameters
    ----------
    prior : Prior
    gate : float
        Of the base,
        in two lines.
    low, high : int
        Both.

    Raises
    ------
    gate : float
        Not an option.
    """


class Mine(Base):
    """Mine.

    Parameters
    ----------
    gate : {"a", "b"}, optional
        Of mine: a colon, too.

        And a paragraph.
    needed : str
    """

    def __init__(self, prior, needed, high=3, gate=0.5, low=1, other=(1, "x"), **_):
        """Take them."""


def test_options_stand_in_the_order_of_the_signature_with_the_nearest_text():
    assert options_of(Mine) == [
        Told({"needed": ""}, ""),
        Told({"low": "1", "high": "3"}, "Both."),
        Told({"gate": "0.5"}, "Of mine: a colon, too. And a paragraph."),
        Told({"other": "(1, 'x')"}, ""),
    ]


def test_a_function_and_what_does_not_tell():
    def mine(dataset, gain=2.0):
        """Mine."""

    assert options_of(mine) == [Told({"gain": "2.0"}, "")]
    assert options_of(dict) == []


@pytest.mark.parametrize("name", registered())
def test_every_option_of_every_estimator_is_listed_once(name):
    maker = named(name)
    listed = [option for told in options_of(maker) for option in told.defaults]
    assert sorted(listed) == sorted(inspect.signature(maker).parameters)
    for told in options_of(maker):
        words = ", ".join(f"{option}={value}" for option, value in told.defaults.items())
        assert resolve(f"{name}({words})") is not None


def test_the_command_lists_them(run_command, tmp_path, monkeypatch):
    shown = run_command("estimators", "iekf(iterations=3)").out.splitlines()
    assert shown[0].startswith("iekf ")
    assert any(line.startswith("accept=0.999, new=0.999999  The two gates") for line in shown)
    assert json.loads(run_command("estimators", "dead-reckoning", "--json").out)["options"] == []
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine_to_list.py").write_text("class Mine:\n    def __init__(self, gain=2): ...\n")
    shown = run_command("estimators", "mine_to_list:Mine").out
    assert [line.split() for line in shown.splitlines()] == [["mine_to_list:Mine"], ["gain=2"]]
    refused = run_command("estimators", "efk")
    assert refused.status == 2
    assert "did you mean ekf" in refused.err
