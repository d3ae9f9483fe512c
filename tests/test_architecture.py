"""The floors of the house: imports only go down, heavy libraries stay in their rooms."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("ekfslam", "baselines", "tests", "benchmarks")

# Each room may import itself and rooms on lower floors. A room is a module with all below it.
FLOORS: dict[int, tuple[tuple[str, ...], ...]] = {
    0: (
        (
            "ekfslam.errors",
            "ekfslam.checks",
            "ekfslam.differences",
            "ekfslam.storage",
            "ekfslam.mat5",
            "ekfslam.compiled",
            "ekfslam.blas",
        ),
    ),
    1: (("ekfslam.geometry", "ekfslam.mahalanobis"), ("ekfslam.association",)),
    2: (("ekfslam.models",),),
    3: (
        (
            "ekfslam.observations",
            "ekfslam.contradictions",
            "ekfslam.robots",
            "ekfslam.dataset",
            "ekfslam.own_models",
            "ekfslam.documents",
            "ekfslam.estimates",
            "ekfslam.registry",
            "ekfslam.adapters",
            "ekfslam.held",
            "ekfslam.moments",
        ),
    ),
    4: (
        ("ekfslam.filters",),
        ("ekfslam.simulation",),
        ("ekfslam.datasets",),
        ("ekfslam.evaluation",),
        ("ekfslam.plots",),
        ("ekfslam.export",),
    ),
    5: (("ekfslam.experiments",), ("ekfslam.validation",), ("baselines",)),
    6: (("ekfslam.report",), ("ekfslam.testing",)),
    7: (("ekfslam.cli",),),
    8: (("ekfslam.__main__",),),
}

# Where a library may be imported at run time; nowhere else.
LIBRARIES = {
    "gtsam": ("baselines",),
    "matplotlib": ("ekfslam.plots",),
    "numba": ("ekfslam.compiled",),
    "PIL": ("ekfslam.plots",),
    "rerun": ("ekfslam.export.rerun_file",),
    "typer": ("ekfslam.cli",),
    "rich": ("ekfslam.cli",),
    "psutil": ("ekfslam.checks",),
    "distributed": ("ekfslam.experiments.cluster",),
    "jinja2": ("ekfslam.report.page",),
    "pyarrow": ("ekfslam.experiments.rows", "ekfslam.experiments.store"),
}

# Figures judge with the intervals that the tables judge with: the one step aside.
ASIDE = {("ekfslam.plots", "ekfslam.evaluation.statistics")}


class Import(NamedTuple):
    """One import statement: from which module, of what, and whether only for the type checker."""

    source: str
    target: str
    types_only: bool


def sources() -> dict[str, Path]:
    """Every module of the two packages with its file."""
    found = {}
    for package in ("ekfslam", "baselines"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imports_of(source: str, text: str, modules: set[str]) -> Iterator[Import]:
    """Imports of a module, also those inside functions."""
    tree = ast.parse(text)
    guards = [n for n in ast.walk(tree) if isinstance(n, ast.If) and "TYPE_CHECKING" in ast.dump(n)]
    for_types = {id(n) for guard in guards for part in guard.body for n in ast.walk(part)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{source}: say imports in full"
            # `from package import module` imports the module.
            whole = {alias.name: f"{node.module}.{alias.name}" for alias in node.names}
            targets = [t if t in modules else str(node.module) for t in whole.values()]
        else:
            continue
        for target in targets:
            yield Import(source, target, id(node) in for_types)


def room(module: str) -> tuple[int, tuple[str, ...]]:
    """Floor and room of a module."""
    for floor, rooms in FLOORS.items():
        for members in rooms:
            if any(module == m or module.startswith(f"{m}.") for m in members):
                return floor, members
    raise LookupError(f"{module} stands on no floor")


def goes_down(source: str, target: str) -> bool:
    """Whether an import is allowed."""
    (here, mine), (there, theirs) = room(source), room(target)
    return there < here or mine == theirs or (mine[0], target) in ASIDE


MODULES = sources()
IMPORTS = [
    entry
    for module, path in MODULES.items()
    for entry in imports_of(module, path.read_text(), set(MODULES))
]
OURS = [i for i in IMPORTS if i.target.split(".")[0] in ("ekfslam", "baselines")]


def test_every_module_stands_on_a_floor():
    assert len(MODULES) > 30
    for module in MODULES:
        if module != "ekfslam":  # the façade, which imports by name when asked
            room(module)


def test_imports_go_down():
    # The façade itself holds only the version; what it offers is not for use inside the house.
    inside = [i for i in OURS if i.source != "ekfslam" and i.target != "ekfslam"]
    assert len(inside) > 100
    assert [i for i in inside if not goes_down(i.source, i.target)] == []


def test_the_facade_is_used_for_the_version_alone():
    users = {i.source for i in OURS if i.target == "ekfslam"}
    assert {user for user in users if room(user)[1] != ("ekfslam.cli",)} == set()


def test_no_module_hides_a_name_of_the_facade():
    """Importing `ekfslam.x` sets the attribute `x` of the package, over a function of that name."""
    import ekfslam

    assert [name for name in ekfslam.__all__ if f"ekfslam.{name}" in MODULES] == []


def test_the_package_does_not_know_the_baselines():
    outside = [i for i in OURS if i.source.split(".")[0] == "ekfslam"]
    assert [i for i in outside if i.target.split(".")[0] == "baselines"] == []


@pytest.mark.parametrize(
    ("source", "target"),
    [
        ("ekfslam.geometry", "ekfslam.dataset"),
        ("ekfslam.evaluation.tables", "ekfslam.filters.ekf_slam"),
        ("ekfslam.filters.ekf_slam", "ekfslam.evaluation"),
        ("ekfslam.validation.ladder", "ekfslam.experiments.compare"),
        ("ekfslam.registry", "baselines.batch"),
    ],
)
def test_the_rule_forbids_what_it_should(source, target):
    assert not goes_down(source, target)


def test_hidden_imports_are_found():
    text = "from ekfslam import dataset\ndef f():\n    import gtsam.utils\n"
    found = list(imports_of("x", text, {"ekfslam.dataset"}))
    assert [i.target for i in found] == ["ekfslam.dataset", "gtsam.utils"]


def test_no_module_imports_in_a_circle():
    below: dict[str, set[str]] = {module: set() for module in MODULES}
    for i in OURS:
        if i.source != i.target and not i.types_only:
            below[i.source].add(i.target)
    while below:
        free = {module for module, targets in below.items() if not targets & below.keys()}
        assert free, f"a circle among {sorted(below)}"
        below = {module: targets for module, targets in below.items() if module not in free}


@pytest.mark.parametrize("library", LIBRARIES)
def test_heavy_libraries_stay_in_their_rooms(library):
    users = {i.source for i in IMPORTS if i.target.split(".")[0] == library and not i.types_only}
    assert users
    homes = LIBRARIES[library]
    assert [u for u in users if not any(u == h or u.startswith(f"{h}.") for h in homes)] == []


RUN = """
import sys
import ekfslam
light = {"numpy", "pandas", "scipy", "matplotlib", "numba", "gtsam"}
assert not light & set(sys.modules), "the facade imports before it is asked"
import ekfslam.evaluation, ekfslam.evaluation.tables
assert not {"matplotlib", "ekfslam.filters"} & set(sys.modules), "evaluation knows too much"
import ekfslam.filters.ekf_slam, ekfslam.simulation, ekfslam.datasets, ekfslam.experiments
import ekfslam.validation, ekfslam.export
assert not {"matplotlib", "gtsam", "baselines"} & set(sys.modules), "the core knows too much"
"""


def test_the_core_runs_without_gtsam_and_matplotlib():
    run = subprocess.run([sys.executable, "-c", RUN], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr


def test_files_fit_a_reader():
    files = [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]
    lengths = {str(p.relative_to(ROOT)): len(p.read_text().splitlines()) for p in files}
    assert {name: lines for name, lines in lengths.items() if lines > 600} == {}
