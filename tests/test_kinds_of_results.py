"""A folder of results is not overwritten by results of another kind."""

import json

import pytest

from ekfslam.errors import InputError
from ekfslam.experiments.files import CAMPAIGN, COMPARISON, check_folder, write_together

CAMPAIGN_FILE = """
seeds = 2
estimators = ["dead-reckoning"]

[[scenarios]]
name = "cloister"
"""


def state(folder):
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture
def commands(run_command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.toml").write_text(CAMPAIGN_FILE)
    return {
        "a comparison": "compare cloister --estimators dead-reckoning --no-figures",
        "a campaign": "campaign mine.toml --no-figures",
        "study association": "study association --seeds 2 --scales 3 --methods nearest",
    }


def test_results_of_another_kind_are_refused_before_the_work(commands, run_command, tmp_path):
    for kind, command in commands.items():
        written = run_command(*command.split(), "--out", kind)
        assert written.status == 0, written.err
    for kind, command in commands.items():
        again = run_command(*command.split(), "--out", kind)
        assert again.status == 0, again.err
        before = state(tmp_path)
        for other in commands.keys() - {kind}:
            refused = run_command(*command.split(), "--out", other)
            assert refused.status == 2
            told = f"ekfslam: {other} holds {other}, not {kind}: give another folder\n"
            assert refused.err == told
        assert state(tmp_path) == before


@pytest.mark.parametrize("text", ['{"theme": "dark"}', "[1]", "{", ""])
def test_a_config_of_something_else_stays(tmp_path, text):
    (tmp_path / "config.json").write_text(text)
    with pytest.raises(InputError, match="of something else, not a comparison"):
        check_folder(tmp_path, COMPARISON)
    check_folder(tmp_path / "new", CAMPAIGN)


def test_what_is_written_at_last_is_held_against_what_is_there(tmp_path):
    """From Python a comparison meets its folder only when it is saved."""
    (tmp_path / "config.json").write_text(json.dumps({"study": "partial"}))
    (tmp_path / "summary.csv").write_text("precious\n")

    def write(folder):
        (folder / "config.json").write_text(json.dumps({"campaign": "mine"}))
        (folder / "summary.csv").write_text("other\n")

    before = state(tmp_path)
    with pytest.raises(InputError, match="holds study partial, not a campaign"):
        write_together(tmp_path, write)
    assert state(tmp_path) == before
