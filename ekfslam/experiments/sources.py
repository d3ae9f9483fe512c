"""Datasets by name, wherever they come from: simulated, recorded, or a file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ekfslam.dataset import Dataset
from ekfslam.datasets import RECORDED, load_recorded
from ekfslam.errors import InputError, UnknownNameError
from ekfslam.registry import parse
from ekfslam.simulation import scenarios, simulate


def open_dataset(
    source: str | Path | Dataset, seed: int = 0, path: str | Path | None = None
) -> Dataset:
    """A dataset from whatever names it.

    Parameters
    ----------
    source : str, path or Dataset
        A scenario or its TOML file (simulated with `seed`), a recorded set, or a file written by
        `Dataset.save` (``.npz``). Options of its loader may follow the name of a recorded set, as
        in ``victoria-park(noise=file)``, and become part of the dataset's name.
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
    name = str(source)
    if name.partition("(")[0].strip() in RECORDED:
        call = parse(name)
        dataset = load_recorded(call.name, path, **call.options)
        return replace(dataset, name=str(call)) if call.options else dataset
    if path is not None:
        raise InputError(f"a path is for recorded datasets, not for {name}")
    if name.endswith(".npz"):
        return Dataset.load(name)
    if name in scenarios() or name.endswith(".toml"):
        return simulate(name, seed=seed)
    if name and Path(name).exists():
        raise InputError(f"{name}: a dataset file ends in .npz, a scenario file in .toml")
    raise UnknownNameError("dataset", name, [*scenarios(), *RECORDED])
