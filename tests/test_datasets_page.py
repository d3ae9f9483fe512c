"""The page on recorded data: every set is on it, and its options are those of the loaders."""

from __future__ import annotations

import re
from importlib import import_module
from inspect import signature
from pathlib import Path

import pytest

from ekfslam.datasets import RECORDED

PAGE = (Path(__file__).parents[1] / "docs" / "datasets.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.*)\n((?:(?!## ).*\n)*)", PAGE, re.MULTILINE))


def section(name):
    """The title and text of the section of a set."""
    stem = name.rstrip("0123456789")
    (found,) = (t for t in SECTIONS if name in t.split(", ") or (stem != name and stem in t))
    return found, SECTIONS[found]


def loader(name):
    recorded = RECORDED[name]
    return signature(getattr(import_module(recorded.module), recorded.loader)).parameters


def test_every_set_has_a_section_in_the_order_of_the_catalogue():
    titles = list(dict.fromkeys(section(name)[0] for name in RECORDED))
    assert list(SECTIONS)[: len(titles)] == titles
    assert PAGE.count("| [`") == len(titles) + 1  # rows of the first table; and Bailey's worlds


@pytest.mark.parametrize("name", RECORDED)
def test_files_and_options_are_those_of_the_loader(name):
    _, text = section(name)
    first_cells = " ".join(re.findall(r"^\| (`.*?) \|", text, re.MULTILINE))
    for option in re.findall(r"`(\w+)`", first_cells):
        assert option in loader(name)
    for option in re.findall(r"`(\w+)=[\w\[., \]-]+`", text):
        assert option in loader(name) or option == "association"
    for file in RECORDED[name].files:
        assert file in text or RECORDED[name].module.endswith(("plaza", "lego", "car_park"))


@pytest.mark.parametrize(
    ("name", "poses", "sightings"),
    [
        ("victoria-park", "6969 poses", ""),
        ("victoria-park-raw", "7209 poses", "36,600 sightings"),
        ("plaza1", "9658 poses", "3527 ranges"),
        ("plaza2", "4091 poses", "1816 ranges"),
        ("lego", "278 scans", "895 finds"),
        ("car-park", "586 scans", "beams: 892,"),
        ("dlr", "3297 steps", "14,745 sightings"),
        ("city-trees", "10,000 poses", ""),
        ("freiburg-course", "331 motions", "1212 sightings"),
    ],
)
def test_counts_are_those_of_the_sets(recorded_data, name, poses, sightings):
    text = " ".join(section(name)[1].split())
    assert poses in text
    assert sightings in text
    options = {"spurious": "keep"} if name == "dlr" else {}
    dataset = recorded_data(name, **options)
    steps = dataset.poses - (poses.endswith(("steps", "motions")))
    assert steps == int(poses.split()[0].replace(",", ""))
    for count in re.findall(r"[\d,]*\d", sightings):
        assert len(dataset.observations) == int(count.replace(",", ""))
