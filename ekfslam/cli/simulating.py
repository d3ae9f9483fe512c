"""The command `simulate`: a dataset drawn from a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ekfslam.cli import completion
from ekfslam.cli.options import Seed


def simulate(
    scenario: Annotated[
        str,
        typer.Argument(help="A name, or a .toml file.", autocompletion=completion.scenarios),
    ],
    out: Annotated[
        Path,
        typer.Option(
            help="File (.npz), or a new folder for tables (CSV).",
            autocompletion=completion.files,
        ),
    ],
    seed: Seed = 0,
    noise: Annotated[float, typer.Option(help="Scale of all noise, stated and drawn.")] = 1.0,
    odometry_noise: Annotated[
        float, typer.Option(help="Scale of the odometry noise alone, stated and drawn.")
    ] = 1.0,
    g2o: Annotated[
        Path | None,
        typer.Option(
            help="Write it as a g2o graph, too.",
            show_default=False,
            autocompletion=completion.files,
        ),
    ] = None,
) -> None:
    """Draw a dataset from a scenario into one file, or into a folder of CSV files.

    [bold]Examples[/bold]

      ekfslam simulate park --seed 7 --out park-7.npz

      ekfslam simulate park --seed 7 --out park-7

      ekfslam simulate "city(world.count=5000, path.steps=10000)" --out city.npz
    """
    from ekfslam.datasets.table_files import write_tables
    from ekfslam.errors import InputError
    from ekfslam.export import write_g2o
    from ekfslam.simulation import load_scenario
    from ekfslam.simulation import simulate as draw

    if out.suffix not in (".npz", ""):
        raise InputError(f"{out}: a dataset file ends in .npz, a folder of tables has no ending")
    for path in filter(None, (out, g2o)):
        if not path.parent.is_dir():
            raise InputError(f"cannot write {path}: there is no folder {path.parent}")
    drawn = load_scenario(scenario)
    dataset = draw(drawn, seed=seed, noise=noise, odometry_noise=odometry_noise)
    written = [str(out)]
    if g2o is not None:  # first: it can be refused for what the dataset holds
        write_g2o(dataset, g2o)
        written.append(str(g2o))
    if out.suffix:
        dataset.save(out)
    else:
        write_tables(dataset, out)
    print(
        f"{dataset.name}: {dataset.poses} poses, {len(dataset.observations)} observations "
        f"-> {', '.join(written)}"
    )
