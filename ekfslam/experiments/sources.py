"""Datasets by name, wherever they come from: simulated, recorded, or a file."""

from __future__ import annotations

from dataclasses import replace
from inspect import signature
from pathlib import Path

from ekfslam.dataset import Dataset
from ekfslam.datasets import RECORDED, is_recorded, load_recorded
from ekfslam.datasets.graph_files import SUFFIXES as GRAPHS
from ekfslam.datasets.graph_files import load as load_graph
from ekfslam.datasets.places import there
from ekfslam.datasets.table_files import HEADER, read_tables
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.registry import parse
from ekfslam.simulation import Scenario, scenarios, simulate


def open_dataset(
    source: str | Path | Dataset | Scenario, seed: int = 0, path: str | Path | None = None
) -> Dataset:
    """A dataset from whatever names it.

    Parameters
    ----------
    source : str, path, Dataset or Scenario
        A scenario or its TOML file (simulated with `seed`; values to set may follow, see
        `ekfslam.load_scenario`), a recorded set, a file written by `Dataset.save` (``.npz``), a
        folder of CSV files with a ``dataset.toml`` (`ekfslam.datasets.table_files`), or a graph
        file (``.g2o``, ``.graph``, ``.pyfg``). Options of its loader may follow the name of a
        recorded set, as in ``victoria-park(noise=file)``, and become part of the dataset's name,
        or that of a graph file, as in ``loop.g2o(unsupported=drop)``.
    seed : int
        Of a simulation.
    path : path, optional
        Where the files of a recorded set lie, if they do not come with a package.

    Raises
    ------
    UnknownNameError
        For a name that nothing carries.
    FileFormatError, InputError
        For a file that cannot be read.
    """
    if isinstance(source, Dataset):
        return source
    if isinstance(source, Scenario):
        return simulate(source, seed=seed)
    name = str(source)
    if is_recorded(name.partition("(")[0].strip()):
        call = parse(name)
        dataset = load_recorded(call.name, path, **call.options)
        return replace(dataset, name=str(call)) if call.options else dataset
    if path is not None:
        raise InputError(f"a path is for recorded datasets, not for {name}")
    if name.endswith(".npz"):
        return Dataset.load(name)
    if name.partition("(")[0].strip().endswith(GRAPHS):
        return _graph(name)
    if Path(name).name == HEADER and there(Path(name), "controls.csv"):
        return read_tables(Path(name).parent)
    scenario = name.partition("(")[0].strip()
    if scenario in scenarios() or scenario.endswith(".toml"):
        return simulate(name, seed=seed)
    if name and (Path(name) / HEADER).exists():
        return read_tables(name)
    if name and Path(name).exists():
        raise InputError(
            f"{name}: a dataset file ends in .npz, a scenario file in .toml, a graph file in "
            f"{', '.join(GRAPHS)}, and a folder of tables has a {HEADER}"
        )
    raise UnknownNameError("dataset", name, [*scenarios(), *RECORDED])


def _graph(name: str) -> Dataset:
    """The dataset of a graph file, whose options may follow its name."""
    call = parse(name)
    try:
        signature(load_graph).bind(call.name, **call.options)
    except TypeError as error:
        raise InputError(f"{call.name}: {error}") from None
    return load_graph(call.name, **call.options)
