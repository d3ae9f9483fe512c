"""Notes of a dataset: where they are kept, and where they are told."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from made import make

from ekfslam.cli.printing import print_summary
from ekfslam.dataset import Dataset
from ekfslam.errors import InputError
from ekfslam.experiments import compare

NOTES = ("ranges are correlated over 5 s <and> [more]: NEES is too large", "12 rows were read")


@pytest.fixture(scope="module")
def comparison():
    """One dataset with notes and one without."""
    data = make()
    noted = replace(data, name="noted", notes=NOTES)
    return compare([noted, replace(data, name="plain")], ["dead-reckoning"])


def test_notes_survive_files_moves_and_withheld_identities(tmp_path):
    data = replace(make(), notes=list(NOTES))
    assert data.notes == NOTES
    data.save(tmp_path / "noted.npz")
    assert Dataset.load(tmp_path / "noted.npz").notes == NOTES
    assert data.moved([1.0, 2.0, 0.3]).notes == NOTES
    assert data.without_identities().notes == NOTES
    assert make().notes == ()


@pytest.mark.parametrize("bad", ["one text", [3], None, 5])
def test_notes_are_several_texts(bad):
    with pytest.raises(InputError, match="notes must be several texts"):
        replace(make(), notes=bad)


def test_notes_are_printed_once_below_their_own_table(comparison, capsys):
    notes = {name: data.notes for name, data in comparison.datasets.items()}
    print_summary(comparison.summary, notes)
    first, second = capsys.readouterr().out.split("plain:")
    for note in NOTES:
        assert first.count(note) == 1
        assert note not in second
    print_summary(comparison.summary)
    assert NOTES[1] not in capsys.readouterr().out


def test_long_notes_are_wrapped(comparison, capsys):
    words = " ".join(f"word{n}" for n in range(100))
    print_summary(comparison.summary, {"noted": [words]})
    lines = capsys.readouterr().out.splitlines()
    told = [line.strip() for line in lines if "word" in line]
    assert len(told) > 1
    assert " ".join(told) == words


def test_notes_are_kept_with_the_comparison_and_shown_in_a_notebook(comparison, tmp_path):
    comparison.save(tmp_path, figures=False)
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["datasets"]["noted"]["notes"] == list(NOTES)
    assert config["datasets"]["plain"]["notes"] == []
    html = comparison._repr_html_()
    assert (
        "<p>noted: ranges are correlated over 5 s &lt;and&gt; [more]: NEES is too large</p>" in html
    )
    assert html.count("<p>") == 2
