"""The notebooks run from top to bottom, without a warning, and show what they draw."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


def draws(cell):
    """Whether a cell makes a figure, as a method of the package or with its style, or shows one."""
    return any(word in cell.source for word in (".plot_", "with drawing(", 'figures["'))


@pytest.mark.filterwarnings("ignore")  # of the kernel's own event loop
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": tmp_path}})
    client.execute()
    for cell in notebook.cells:
        outputs = cell.get("outputs", ())
        pictures = [o for o in outputs if "image/png" in o.get("data", {})]
        assert len(pictures) == (cell.cell_type == "code" and draws(cell))
        assert not [o for o in outputs if o.get("name") == "stderr"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_kept_without_outputs(path):
    for cell in nbformat.read(path, as_version=4).cells:
        assert not cell.get("outputs")
        assert cell.get("execution_count") is None


def test_there_are_notebooks():
    names = {"01_quickstart", "02_from_the_texts", "03_consistency"}
    assert names <= {path.stem for path in NOTEBOOKS}
