"""Sizes in words, and what does not fit."""

from __future__ import annotations

import psutil
import pytest

from ekfslam import checks
from ekfslam.errors import UnsupportedError

FREE = 21_300_000_000


@pytest.fixture
def _some_memory(monkeypatch):
    memory = psutil.virtual_memory()._replace(available=FREE)
    monkeypatch.setattr(psutil, "virtual_memory", lambda: memory)


@pytest.mark.usefixtures("_some_memory")
def test_what_does_not_fit_is_refused_with_its_size():
    what, instead = "the covariance of 200000 landmarks", "ask for marginal ones"
    with pytest.raises(UnsupportedError) as refused:
        checks.check_fits((2 * 200_000) ** 2 * 8, what, instead)
    assert str(refused.value) == f"{what} needs 1.28 TB, 21.3 GB are free: {instead}"
    with pytest.raises(UnsupportedError, match=r"are free$"):
        checks.check_fits(FREE + 1, what)


@pytest.mark.usefixtures("_some_memory")
def test_what_fits_passes():
    checks.check_fits(FREE, "all that is free")
    checks.check_fits(0, "nothing")


def test_this_machine_is_asked():
    checks.check_fits(1000, "a little")
    with pytest.raises(UnsupportedError, match=r"needs 1 EB, [\d.]+ .B are free"):
        checks.check_fits(10**18, "a lot")


@pytest.mark.parametrize(
    ("size", "said"),
    [
        (0, "0 B"),
        (999, "999 B"),
        (1000, "1 kB"),
        (1_284_000_000_000, "1.28 TB"),
        (999_499, "999 kB"),
        (999_500, "1 MB"),
        (21_340_000_000, "21.3 GB"),
        (213_400_000, "213 MB"),
        (5 * 10**21, "5000 EB"),
    ],
)
def test_a_size_has_three_digits(size, said):
    assert checks.in_bytes(size) == said
