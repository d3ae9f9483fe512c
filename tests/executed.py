"""Notebooks with their outputs, as they are kept: what a code host shows, and no noise.

``make notebooks`` runs all of them, or some: ``python tests/executed.py 04_your_own_filter``.
"""

from __future__ import annotations

import base64
import os
import re
import sys
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import nbformat
import numpy as np
from nbclient import NotebookClient
from PIL import Image

FOLDER = Path(__file__).parents[1] / "notebooks"
LIVE = "live"
"""Tag of a cell whose outputs are not kept: times of a machine, and sliders without a kernel."""
COLORS = 128  # of a kept picture: a third of its size, and no eye sees it
AREAS = 16  # of these: what covers most of the picture, as it is
NONE = Image.Dither.NONE
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
ROUND_OFF = 1e-9


def executed(path: Path, data: str | None = None) -> Any:
    """A notebook run from top to bottom in a folder of its own.

    Parameters
    ----------
    path : Path
    data : str, optional
        The folder of recorded data; none by default, whatever the environment says, so that
        everyone gets the same.
    """
    notebook = nbformat.read(path, as_version=4)
    environment = {k: v for k, v in os.environ.items() if k != "EKFSLAM_DATA"}
    environment["OPENBLAS_NUM_THREADS"] = "1"  # small matrices; threads would wait for each other
    if data is not None:
        environment["EKFSLAM_DATA"] = data
    with TemporaryDirectory() as folder, patch.dict(os.environ, environment, clear=True):
        client = NotebookClient(
            notebook,
            timeout=300,
            coalesce_streams=True,  # else a text falls apart differently each time
            resources={"metadata": {"path": folder}},
        )
        client.execute()
    return notebook


def cleaned(notebook: Any) -> Any:
    """Without counts, times and versions, and with small pictures; changed in place."""
    notebook.metadata.language_info = {"name": "python"}
    for cell in notebook.cells:
        tags = cell.metadata.get("tags", [])
        cell.metadata = {"tags": tags} if tags else {}
        if cell.cell_type != "code":
            continue
        cell.execution_count = None
        cell.outputs = [] if LIVE in tags else cell.outputs
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = None
            if "image/png" in output.get("data", {}):
                output.data = {"image/png": smaller(output.data["image/png"])}
                output.metadata = {}
    return notebook


def smaller(picture: str) -> str:
    """A base64 PNG with a palette."""
    with Image.open(BytesIO(base64.b64decode(picture))) as image:
        full = image.convert("RGB").point(lambda value: value | 3)  # nearly white is white
    # Areas keep their colour, such as the grey of a band; this method keeps rare ones, such as
    # that of a thin line.
    areas = [color for _, color in sorted(full.getcolors(2**24), reverse=True)[:AREAS]]
    rare = full.quantize(COLORS - AREAS, Image.Quantize.MAXCOVERAGE, dither=NONE).getpalette()
    palette = np.array([*np.ravel(areas), *rare[: 3 * (COLORS - AREAS)]]).reshape(-1, 3)
    numbers = np.asarray(full, dtype=int) @ [1 << 16, 1 << 8, 1]
    found, where = np.unique(numbers, return_inverse=True)
    colors = np.stack([found >> 16, found >> 8 & 255, found & 255], axis=1)
    nearest = np.argmin(((colors[:, None] - palette) ** 2).sum(axis=2), axis=1)
    indexed = Image.fromarray(nearest[where].reshape(numbers.shape).astype(np.uint8))
    indexed.putpalette(palette.astype(np.uint8).tobytes())
    stream = BytesIO()
    indexed.save(stream, "png", optimize=True)
    return base64.b64encode(stream.getvalue()).decode()


def texts(cell: Any) -> list[str]:
    """What a cell printed and showed as text."""
    outputs = cell.get("outputs", ())
    return [
        output.get("text") or output.get("data", {}).get("text/plain", "") for output in outputs
    ]


def same(text: str, other: str) -> bool:
    """Whether two texts have the same words, and the same numbers but for round-off."""
    words, others = NUMBER.sub("#", text).split(), NUMBER.sub("#", other).split()
    numbers, theirs = [list(map(float, NUMBER.findall(t))) for t in (text, other)]
    return words == others and all(
        abs(a - b) <= max(ROUND_OFF, 2e-3 * abs(a)) for a, b in zip(numbers, theirs, strict=True)
    )


if __name__ == "__main__":
    for notebook_path in sorted(FOLDER.glob("*.ipynb")):
        if notebook_path.stem in sys.argv[1:] or not sys.argv[1:]:
            print(notebook_path.stem)
            nbformat.write(cleaned(executed(notebook_path)), notebook_path)
