"""Options behind the name of an estimator: read, passed on, shown, refused."""

from __future__ import annotations

import sys

import pytest

from ekfslam.errors import InputError, UnknownNameError
from ekfslam.estimates import Estimate
from ekfslam.registry import estimator_name, parse, resolve, split


class Gated:
    """An estimator with options of several kinds."""

    def __init__(self, gate=0.95, pair=(1, 2), word="plain", first=None):
        self.options = {"gate": gate, "pair": pair, "word": word, "first": first}

    def estimate(self, dataset):
        return Estimate("gated", dataset.name)


class Anything(Gated):
    """Takes whatever it is given."""

    def __init__(self, **options):
        self.options = options


HERE = f"{__name__}:Gated"


@pytest.fixture(autouse=True)
def importable(monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setitem(sys.modules, __name__, sys.modules[__name__])


@pytest.mark.parametrize(
    ("text", "options"),
    [
        ("", {}),
        ("()", {}),
        ("( )", {}),
        ("(gate=0.5)", {"gate": 0.5}),
        ("(gate=1e-3, pair=(3, 4))", {"gate": 1e-3, "pair": (3, 4)}),
        ("(gate = -1 ,pair=[(1,2),3],)", {"gate": -1, "pair": [(1, 2), 3]}),
        ("(gate=None, first=True)", {"gate": None, "first": True}),
        ("(word=maximum-likelihood)", {"word": "maximum-likelihood"}),
        ("(word=global)", {"word": "global"}),  # of no meaning to Python but its own
        ("(word='a, (b', gate=2)", {"word": "a, (b", "gate": 2}),
        ('(word="it\'s")', {"word": "it's"}),
        ("(word=ekf(association=joint, confirm=3))", {"word": "ekf(association=joint, confirm=3)"}),
        ("(word=module:Class)", {"word": "module:Class"}),
        ("(word='')", {"word": ""}),
    ],
)
def test_options_reach_the_class(text, options):
    assert parse(f"name{text}").options == options
    assert resolve(HERE + text).options == Gated(**options).options


@pytest.mark.parametrize(
    ("given", "shown"),
    [
        ("ekf", "ekf"),
        ("ekf()", "ekf"),
        (" ekf (association=joint,confirm = 3)", "ekf(association=joint, confirm=3)"),
        ("ekf(confirm=3,\n  association=joint)", "ekf(confirm=3, association=joint)"),
        ("my.module:Mine(gate=1)", "Mine(gate=1)"),
        ("module:Mine(first=other:Theirs)", "Mine(first=other:Theirs)"),
        ("ekf(naive_distance=(5,\n2))", "ekf(naive_distance=(5, 2))"),
    ],
)
def test_the_name_in_tables_is_the_text_with_normal_spacing(given, shown):
    assert estimator_name(given) == shown
    assert estimator_name(shown) == shown


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ekf(confirm=3", "does not end with the bracket"),
        ("ekf(confirm=3)x", "does not end with the bracket"),
        ("ekf(confirm=(3)", "do not match"),
        ("ekf(confirm=3))", "do not match"),
        ("ekf(association='joint)", "do not match"),
        ("ekf(confirm)", "'confirm' in .* is no option: write option=value"),
        ("ekf(3)", "'3' in .* is no option"),
        ("ekf(=3)", "'=3' in .* is no option"),
        ("ekf(a-b=3)", "'a-b=3' in .* is no option"),
        ("ekf(confirm=)", "cannot read '' in .*; put text in quotes"),
        ("ekf(confirm=3 4)", "cannot read '3 4'"),
        ("ekf(confirm=__import__('os'))", "confirm must be a whole number"),  # text, never run
        ("ekf(confirm=1+1)", r"cannot read '1\+1'"),
        ("ekf(confirm=3, confirm=4)", "option confirm is given twice"),
        ("ekf(confirm=three)", "confirm must be a whole number from 1 on, got 'three'"),
        ("ekf(association=jiont)", "association must be one of known, nearest"),
        ("ekf(naive_distance=5)", "naive_distance must be a mean and a deviation"),
        ("dead-reckoning(gate=1)", "dead-reckoning takes no options, got gate"),
    ],
)
def test_what_cannot_be_read_is_refused(text, message):
    with pytest.raises(InputError, match=message) as caught:
        resolve(text)
    assert "\n" not in str(caught.value)


def test_an_unknown_option_is_told_with_close_ones_or_all():
    with pytest.raises(UnknownNameError, match="unknown option of ekf 'asociation'; did you mean"):
        resolve("ekf(asociation=joint)")
    with pytest.raises(UnknownNameError, match="option of ekf 'zzz'; known: accept, association, "):
        resolve("ekf(zzz=1)")
    with pytest.raises(UnknownNameError, match="option of ekf 'asociation'"):
        resolve("ekf", asociation="joint")
    with pytest.raises(UnknownNameError, match="unknown estimator 'efk'; did you mean ekf"):
        resolve("efk(confirm=3)")


def test_a_class_that_takes_anything_gets_it():
    assert resolve(f"{__name__}:Anything(zzz=1)").options == {"zzz": 1}


def test_options_in_the_text_and_beside_it_go_together_but_not_twice():
    assert resolve(f"{HERE}(gate=1)", word="w").options["word"] == "w"
    assert resolve(f"{HERE}(gate=1)", word="w").options["gate"] == 1
    with pytest.raises(InputError, match="option gate is given twice"):
        resolve(f"{HERE}(gate=1)", gate=1)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", []),
        (" , ", []),
        ("a, b", ["a", "b"]),
        ("e(a=joint, c=3),b", ["e(a=joint, c=3)", "b"]),
        ("a('x,y'),b", ["a('x,y')", "b"]),
        ("a([1, 2], {3: 4}), b", ["a([1, 2], {3: 4})", "b"]),
    ],
)
def test_commas_inside_brackets_and_quotes_do_not_separate(text, parts):
    assert split(text) == parts


@pytest.mark.parametrize("text", ["a(", "a)", ")a(", "a'", "a(b,c"])
def test_what_does_not_match_is_refused(text):
    with pytest.raises(InputError, match="brackets or quotes do not match"):
        split(text)


def test_options_of_estimators_inside_options():
    """A smoother that takes its associations from a filter of the user's choice."""
    subject = resolve("gtsam-batch(initial=ekf(association=joint, confirm=3))")
    assert resolve(subject.initial).association == "joint"
    assert resolve(subject.initial).confirm == 3
