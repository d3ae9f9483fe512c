"""What a user's own tests import; the assertions work in any script, and better in pytest.

Names are imported when they are first used: pytest loads this package at every start.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ekfslam.testing.assertions import assert_accuracy, assert_consistent, assert_not_worse
    from ekfslam.testing.findings import Finding
    from ekfslam.testing.jacobians import check_jacobians

_HOMES = {
    "Finding": "ekfslam.testing.findings",
    "assert_accuracy": "ekfslam.testing.assertions",
    "assert_consistent": "ekfslam.testing.assertions",
    "assert_not_worse": "ekfslam.testing.assertions",
    "check_jacobians": "ekfslam.testing.jacobians",
}

__all__ = [
    "Finding",
    "assert_accuracy",
    "assert_consistent",
    "assert_not_worse",
    "check_jacobians",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'ekfslam.testing' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])
