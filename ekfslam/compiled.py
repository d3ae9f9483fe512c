"""How the hot loops are compiled: plain Python through numba, cached on disk.

Every compiled function also runs uncompiled: ``function.py_func``, or all of them with the
environment variable ``NUMBA_DISABLE_JIT=1``.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import llvmlite.binding
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import get_cython_function_address, intrinsic, overload

F = TypeVar("F", bound=Callable)
PACKAGE = Path(__file__).parent
# What compiled functions are made of, with the constants that are frozen into them.
SOURCES = (
    "compiled.py",
    "blas.py",
    "estimates.py",
    "association/*.py",
    "filters/*.py",
    "filters/fastslam/*.py",
    "filters/variants/*.py",
    "models/*.py",
)


@cache
def _cache_folder() -> str:
    """A cache folder that belongs to this state of the sources.

    numba renews a cached function when its own file changes, but not when a function that it
    calls changes in another file; a folder per state of the sources makes a stale kernel
    impossible. Where the package is not writable, numba's own choice stands.
    """
    base = PACKAGE / "__pycache__"
    digest = hashlib.sha256()
    for source in sorted(path for part in SOURCES for path in PACKAGE.glob(part)):
        digest.update(source.read_bytes())
    folder = base / f"kernels-{digest.hexdigest()[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return ""
    if not os.access(folder, os.W_OK):
        return ""
    for old in base.glob("kernels-*"):
        if old != folder:
            shutil.rmtree(old, ignore_errors=True)
    return str(folder)


def compiled(function: F) -> F:
    """Compile with numba at the first call, cached on disk.

    Only multiply-add contraction is allowed beyond strict floating point, so NaN and infinity
    keep their meaning.
    """
    return _compile(function, "never", counted=True)


def lean(function: F) -> F:
    """Compile as `compiled` does, for a function that makes no arrays: no reference is counted.

    All arrays it works with are the caller's. In the loop of a small map, counting references
    takes longer than the work.
    """
    return _compile(function, "never", counted=False)


def inlined(function: F) -> F:
    """Compile into every compiled function that calls it; from Python it is as `compiled`.

    For the few functions of a hot loop that take whole tuples of arrays: those are passed field by
    field, hundreds of words for the state of a filter, and such a call takes as long as the work.
    """
    return _compile(function, "always", counted=True)


def _compile(function: F, inline: str, counted: bool) -> F:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = before or _cache_folder()  # NUMBA_CACHE_DIR, if set, wins
    try:
        options = {"error_model": "numpy", "fastmath": {"contract"}, "inline": inline}
        return numba.njit(cache=True, _nrt=counted, **options)(function)
    finally:
        numba.config.CACHE_DIR = before


def prepare(function: Callable, *arguments: Any) -> None:
    """Compile a function for such arguments, or load it from disk, without calling it.

    So that no clock has to count it.
    """
    if hasattr(function, "compile"):  # not so where compilation is switched off
        function.compile(tuple(numba.typeof(argument) for argument in arguments))


def library_function(module: str, name: str, arguments: int) -> Callable:
    """A function of a compiled library for compiled code to call, every argument by reference.

    It is known to the linker by its name, not by its address, so that callers can be cached.

    Parameters
    ----------
    module, name : str
        A Cython module that exports it, such as ``scipy.linalg.cython_blas``.
    arguments : int
        How many it takes: each an address, such as ``array.ctypes.data``.

    Returns
    -------
    Callable
        Not for uncompiled code.
    """
    symbol = f"ekfslam_{name}"
    llvmlite.binding.add_symbol(symbol, get_cython_function_address(module, name))
    return types.ExternalFunction(symbol, types.void(*[types.uintp] * arguments))


def now() -> float:
    """Monotonic time [s], from Python and from compiled code.

    Compiled code reads the POSIX clock; where there is none (Windows) it gives NaN, and times per
    step stay empty.
    """
    return time.perf_counter()


_MONOTONIC = 6 if sys.platform == "darwin" else 1


@intrinsic
def _posix_seconds(context: Any) -> Any:
    """Seconds of the POSIX clock; its two words stand on the stack."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        word, of_clock = ir.IntType(64), ir.IntType(32)
        timespec = cgutils.alloca_once(builder, word, size=2)
        kind = ir.FunctionType(of_clock, [of_clock, word.as_pointer()])
        clock = cgutils.get_or_insert_function(builder.module, kind, "clock_gettime")
        builder.call(clock, [ir.Constant(of_clock, _MONOTONIC), timespec])
        seconds, nanoseconds = (
            builder.sitofp(builder.load(cgutils.gep(builder, timespec, i)), ir.DoubleType())
            for i in range(2)
        )
        scaled = builder.fmul(nanoseconds, ir.Constant(ir.DoubleType(), 1e-9))
        return builder.fadd(seconds, scaled)

    return types.float64(), generate


@overload(now)
def _compiled_now() -> Callable[[], float]:
    if sys.platform == "win32":
        return lambda: np.nan
    return lambda: _posix_seconds()
