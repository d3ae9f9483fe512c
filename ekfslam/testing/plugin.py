"""The pytest plugin: options, the fixture, and references written when all tests have run.

pytest loads it in every project of an environment: it imports nothing beyond pytest.
"""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ekfslam.testing.session import Session, current, enter, leave

_SESSION = pytest.StashKey[Session]()
_WRITTEN = pytest.StashKey[list[str]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the command line."""
    group = parser.getgroup("ekfslam", "ekfslam: accuracy and consistency of estimators")
    group.addoption(
        "--ekfslam-update",
        action="store_true",
        help="rewrite the references that the tests compare with, instead of comparing",
    )
    group.addoption(
        "--ekfslam-figures",
        metavar="DIR",
        help="where figures of failed assertions go; in the folder of pytest's cache by default",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Begin the session that the assertions find."""
    session = Session(
        updating=config.getoption("--ekfslam-update"),
        place=lambda: _figures(config),
        root=config.rootpath,
    )
    config.stash[_SESSION], config.stash[_WRITTEN] = session, []
    enter(session)
    config.add_cleanup(lambda: leave(session))


def _figures(config: pytest.Config) -> Path:
    given = config.getoption("--ekfslam-figures")
    if given is not None:
        return Path(config.invocation_params.dir, given)
    if config.pluginmanager.has_plugin("cacheprovider"):
        return config.cache.mkdir("ekfslam-figures")
    return Path(tempfile.gettempdir(), "ekfslam-figures")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Tell the assertions which test asks."""
    session = item.config.stash[_SESSION]
    session.test = item.nodeid
    try:
        return (yield)
    finally:
        session.test = ""


@pytest.fixture
def ekfslam_testing() -> Session:
    """The session of the assertions: `updating`, `figures` of this test, `forget()`."""
    return current()


# References ------------------------------------------------------------------------------------


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write what was asked for; a worker of xdist hands it on."""
    config = session.config
    rewritten = config.stash[_SESSION].rewritten
    if hasattr(config, "workeroutput"):
        config.workeroutput["ekfslam"] = json.dumps(rewritten)
        return
    if not rewritten:
        return
    from ekfslam.testing.references import rewrite

    for path, records in sorted(rewritten.items()):
        rewrite(Path(path), records)
        groups = sorted({f"{row['estimator']} on {row['scenario']}" for row in records})
        shown = os.path.relpath(path, config.invocation_params.dir)
        config.stash[_WRITTEN].append(f"{shown}: {', '.join(groups)}")


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """Take what a worker of xdist hands on."""
    rewritten = node.config.stash[_SESSION].rewritten
    handed = json.loads(getattr(node, "workeroutput", {}).get("ekfslam", "{}"))
    for path, records in handed.items():
        rewritten.setdefault(path, []).extend(records)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say which references were rewritten."""
    written = terminalreporter.config.stash[_WRITTEN]
    if written:
        terminalreporter.section("ekfslam: references rewritten")
        for line in written:
            terminalreporter.line(line)
