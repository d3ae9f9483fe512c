"""What the shell may offer for a word that is half typed: names and files, from light imports.

An empty offer leaves the word to the shell, which completes files and folders as for any command.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.metadata import entry_points
from pathlib import Path

SCENARIOS = Path(__file__).parents[1] / "simulation" / "scenarios"
GROUP = "ekfslam.estimators"  # of the registry, which takes long to import
GRAPHS = (".g2o", ".graph", ".pyfg")


def estimators(incomplete: str) -> list[str]:
    """Names of estimators after the last comma; options in brackets are the user's to write."""
    before, comma, word = incomplete.rpartition(",")
    if "(" in word or before.count("(") > before.count(")"):
        return []
    return [f"{before}{comma}{name}" for name in _starting(word, _estimators())]


def datasets(incomplete: str) -> list[str]:
    """Scenarios, recorded sets and their parts, and files of this folder that hold a dataset."""
    names = [*_scenarios(), *_recorded(incomplete), *_files(".npz", ".toml", *GRAPHS)]
    return _starting(incomplete, names)


def scenarios(incomplete: str) -> list[str]:
    """Scenarios, and files of this folder that may state one."""
    return _starting(incomplete, [*_scenarios(), *_files(".toml")])


def recorded(incomplete: str) -> list[str]:
    """Recorded sets, and after a slash their parts."""
    return _starting(incomplete, _recorded(incomplete))


def alignments(incomplete: str) -> list[str]:
    """What errors may be taken after."""
    return _starting(incomplete, ["none", "se2"])


def forms(incomplete: str) -> list[str]:
    """Forms of tables."""
    return _starting(incomplete, ["auto", "csv", "parquet"])


def files(incomplete: str) -> list[str]:
    """Nothing: files and folders are for the shell."""
    return []


def _starting(word: str, names: Iterable[str]) -> list[str]:
    return sorted(name for name in names if name.startswith(word))


def _estimators() -> set[str]:
    return {point.name for point in entry_points(group=GROUP)}


def _scenarios() -> list[str]:
    return [path.stem for path in SCENARIOS.glob("*.toml")]


def _recorded(incomplete: str) -> list[str]:
    """Sets; the parts of one once it is chosen, or there would be too many to look at."""
    from ekfslam.datasets.catalogue import RECORDED

    whole, slash, _ = incomplete.partition("/")
    parts = RECORDED[whole].parts if slash and whole in RECORDED else ()
    return [*RECORDED, *(f"{whole}/{part}" for part in parts)]


def _files(*suffixes: str) -> list[str]:
    return [path.name for path in Path().iterdir() if path.suffix in suffixes]
