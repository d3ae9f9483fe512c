"""Estimators by name, by module:attribute, by class and as objects."""

from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint

import pytest

from ekfslam import registry
from ekfslam.errors import InputError, UnknownNameError, UnsupportedError
from ekfslam.estimates import Estimate
from ekfslam.registry import Estimator, estimator_name, registered, resolve


class Still:
    """An estimator that says nothing, with one option."""

    name = "still"

    def __init__(self, gate=0.95):
        self.gate = gate

    def estimate(self, dataset):
        return Estimate(self.name, dataset.name)


class NotAnEstimator:
    pass


@pytest.fixture(autouse=True)
def installed_anew():
    """What is installed is looked up once per process; here it changes."""
    registered.cache_clear()
    yield
    registered.cache_clear()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A working folder for modules; what they leave in the interpreter is taken back."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - before:
        del sys.modules[name]


MODULE = """
class Mine:
    def __init__(self, gate=0.5):
        self.gate = gate
    def estimate(self, dataset):
        return None

class Outer:
    Inner = Mine

def make():
    return Mine(gate=0.25)

def of_two(dataset, other):
    return None

ready = Mine(gate=0.75)
constant = 3
"""


@pytest.fixture
def mine(folder):
    (folder / "my_estimators.py").write_text(MODULE)


def test_the_package_and_the_baselines_are_registered():
    assert {"ekf", "gtsam-batch", "gtsam-isam2", "dead-reckoning"} <= set(registered())
    assert list(registered()) == sorted(registered())


def test_a_name_stands_for_its_entry_point(monkeypatch):
    point = EntryPoint("still", f"{__name__}:Still", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda **_: [point])
    assert isinstance(resolve("still"), Still)
    assert resolve("still", gate=0.5).gate == 0.5


@pytest.mark.parametrize(
    ("name", "close"),
    [("ekff", "ekf"), ("gtsam-bach", "gtsam-batch"), ("dead_reckoning", "dead-reckoning")],
)
def test_an_unknown_name_gets_close_ones(name, close):
    with pytest.raises(
        UnknownNameError, match=f"unknown estimator '{name}'; did you mean .*{close}"
    ):
        resolve(name)


@pytest.mark.parametrize("name", ["", "zzzzzz"])
def test_an_unknown_name_without_close_ones_gets_all(name):
    with pytest.raises(
        UnknownNameError, match=r"known: dead-reckoning, ekf, ekf-compressed, .*gtsam-batch"
    ):
        resolve(name)


@pytest.mark.usefixtures("mine")
def test_module_and_attribute_work_wherever_a_name_does():
    assert resolve("my_estimators:Mine").gate == 0.5
    assert resolve("my_estimators:Mine", gate=0.1).gate == 0.1
    assert resolve("my_estimators:Outer.Inner").gate == 0.5
    assert resolve("my_estimators:make").gate == 0.25
    assert resolve("my_estimators:ready").gate == 0.75


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("absent_module:Mine", "cannot load estimator 'absent_module:Mine': No module named"),
        ("my_estimators:Absent", "has no attribute 'Absent'"),
        ("my_estimators:Mine.absent", "has no attribute 'absent'"),
        ("my_estimators:Mines", r"has no attribute 'Mines'; did you mean Mine\?"),
        ("my_estimators:", "cannot load estimator 'my_estimators:': write my_estimators:MyFilter"),
        ("my_estimators", "'my_estimators': write my_estimators:MyFilter"),
        ("./my_estimators.py", r"write my_estimators:MyFilter, in the folder of the file"),
        ("my_estimators.py:Mine", "write my_estimators:Mine, in the folder of the file"),
        ("my_estimators:of_two", r"cannot make of_two: .* missing .* as in of_two\(option=value\)"),
        (":Mine", "cannot load estimator ':Mine'"),
        ("my_estimators:constant", "3 is no estimator"),
    ],
)
def test_what_cannot_be_loaded(name, message):
    with pytest.raises(InputError, match=message) as caught:
        resolve(name)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("mine")
def test_a_module_that_was_edited_is_loaded_anew(folder):
    old, known = resolve("my_estimators:Mine"), registry.origin("my_estimators:Mine")
    assert resolve("my_estimators:Mine").__class__ is old.__class__
    (folder / "my_estimators.py").write_text(MODULE.replace("gate=0.5", "gate=0.875"))
    assert resolve("my_estimators:Mine").gate == 0.875
    assert registry.origin("my_estimators:Mine(gate=1)") != known


@pytest.mark.usefixtures("mine")
def test_where_an_estimator_comes_from(folder):
    assert registry.origin("ekf(association=joint)") == registry.origin("gtsam-batch") == ""
    assert re.fullmatch("my_estimators [0-9a-f]{8}", registry.origin("my_estimators:Mine"))
    assert registry.origin("absent_module:Mine") == ""
    (folder / "package").mkdir()
    (folder / "package" / "__init__.py").write_text("")
    (folder / "package" / "parts.py").write_text("import numpy")
    before = registry.origin("package.parts:Mine")
    assert before.startswith("package ")
    (folder / "package" / "other.py").write_text("import math")
    assert registry.origin("package.parts:Mine") != before


@pytest.mark.parametrize(
    "source",
    ["def broken(:", "raise RuntimeError('no')", "import absent_dependency", "1 / 0", "exit('no')"],
)
def test_modules_that_fail_to_import(source, folder):
    (folder / "failing.py").write_text(source)
    with pytest.raises(InputError, match="cannot load estimator 'failing:Mine'"):
        resolve("failing:Mine")


def test_an_entry_point_that_fails_to_import(monkeypatch):
    """A baseline whose library is not installed: an error that names it, no traceback."""
    point = EntryPoint("broken", "absent_dependency:Thing", registry.GROUP)
    monkeypatch.setattr(registry, "entry_points", lambda **_: [point])
    with pytest.raises(InputError, match=r"cannot load estimator 'broken'.*absent_dependency"):
        resolve("broken")


def test_objects_and_classes():
    ready = Still(gate=0.1)
    assert resolve(ready) is ready
    assert isinstance(resolve(Still), Still)
    assert resolve(Still, gate=0.2).gate == 0.2
    assert resolve(lambda: ready) is ready
    assert isinstance(ready, Estimator)


@pytest.mark.parametrize("thing", [None, 3, NotAnEstimator, NotAnEstimator(), lambda: None])
def test_what_is_no_estimator(thing):
    with pytest.raises(InputError, match="is no estimator: it has no estimate"):
        resolve(thing)


def test_options_must_fit():
    with pytest.raises(UnknownNameError, match="unknown option of still 'speed'; known: gate"):
        resolve(Still, speed=3)
    with pytest.raises(InputError, match="options gate are for a name or a class"):
        resolve(Still(), gate=0.5)


def test_names_in_tables():
    assert estimator_name("ekf") == "ekf"
    assert estimator_name("my_estimators:Mine") == "Mine"
    assert estimator_name(Still()) == "still"
    assert estimator_name(NotAnEstimator()) == "NotAnEstimator"
    assert estimator_name(Still) == "still"
    assert estimator_name(NotAnEstimator) == "NotAnEstimator"


def test_without_an_oracle_the_error_says_so(monkeypatch):
    monkeypatch.setattr(registry, "entry_points", lambda **_: [])
    with pytest.raises(UnsupportedError, match="linear oracle"):
        registry.linear_oracle()
