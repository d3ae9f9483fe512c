"""The notebooks run from top to bottom without a warning, and are kept as they come out.

``make notebooks`` rewrites what is kept. Texts and numbers are held against a fresh run; pictures
depend on the version of matplotlib and are only held to be there.
"""

from __future__ import annotations

import os
import re

import nbformat
import pytest
from executed import FOLDER, LIVE, cleaned, executed, same, texts

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 500_000  # bytes: more than that a code host is slow to show
NOISE = re.compile(r" at 0x[0-9a-f]{6}|/tmp/|/home/|/root/|\x1b\[")


def draws(cell):
    """Whether a cell makes a figure, as a method of the package or with its style, or shows one."""
    figure = any(word in cell.source for word in (".plot_", "with drawing(", 'figures["'))
    return cell.cell_type == "code" and figure and LIVE not in cell.metadata.get("tags", ())


def pictures(cell):
    return [o for o in cell.get("outputs", ()) if "image/png" in o.get("data", {})]


def of_kind(cell, *kinds):
    outputs = cell.get("outputs", ())
    return [o for o in outputs if o.output_type in kinds or o.get("name") in kinds]


@pytest.mark.filterwarnings("ignore")  # of the kernel's own event loop
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_and_says_what_is_kept(path):
    fresh = executed(path)
    assert not [cell for cell in fresh.cells if of_kind(cell, "error", "stderr")]
    kept = nbformat.read(path, as_version=4)
    for cell, other in zip(cleaned(fresh).cells, kept.cells, strict=True):
        said = list(zip(texts(cell), texts(other), strict=True))
        assert not [pair for pair in said if not same(*pair)], "run `make notebooks`"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_what_is_kept_reads_on_a_code_host(path):
    assert path.stat().st_size < LARGEST
    for cell in nbformat.read(path, as_version=4).cells:
        assert cell.get("execution_count") is None
        assert set(cell.metadata) <= {"tags"}
        assert len(pictures(cell)) == draws(cell)
        assert not of_kind(cell, "error", "stderr")
        assert not NOISE.search("".join(texts(cell)))
        assert not (LIVE in cell.metadata.get("tags", ()) and cell.outputs)


@pytest.mark.filterwarnings("ignore")
def test_recorded_data_are_shown_where_they_are():
    data = os.environ.get("EKFSLAM_DATA")
    if not data:
        pytest.skip("needs the folder of EKFSLAM_DATA")
    last = executed(FOLDER / "05_recorded_data.ipynb", data).cells[-1]
    assert "ekf-ri" in "".join(texts(last))


def test_numbers_are_the_same_but_for_round_off():
    assert same("gap 0.12345 m", "gap  0.12346\nm")
    assert same("off by 3e-15", "off by 8e-16")
    assert not same("gap 0.123 m", "gap 0.125 m")
    assert not same("gap 0.123 m", "gap 0.123 m, lost")
    assert not same("gap NaN", "gap 0.1")


def test_there_are_notebooks():
    assert [path.stem[:2] for path in NOTEBOOKS] == ["01", "02", "03", "04", "05", "06"]
