# SPDX-License-Identifier: GPL-3.0-or-later
"""For all tests: what fails is named at once, and what tests/slow.txt lists is marked. Pytest's report has which faults
of tests/faults.toml a test shows, from which docs/reliability.md is made, and its processor seconds.
"""

import subprocess
import sys
import time
from pathlib import Path

import pytest

if sys.platform != "win32":
    import resource

SLOW = Path(__file__).with_name("slow.txt")  # tools/slow_tests.py
BEGAN = pytest.StashKey[float]()


@pytest.fixture
def children(monkeypatch):
    """The processes that are started."""
    started = []

    class Child(subprocess.Popen):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            started.append(self)

    monkeypatch.setattr(subprocess, "Popen", Child)
    return started


class NameFailures:
    def __init__(self, terminal):
        self.terminal = terminal

    @pytest.hookimpl(trylast=True)
    def pytest_runtest_logreport(self, report):
        if report.failed:
            self.terminal.write(f"\nFAILED {report.nodeid}\n")


@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    if terminal := config.pluginmanager.get_plugin("terminalreporter"):
        config.pluginmanager.register(NameFailures(terminal))


def pytest_addoption(parser):
    parser.addoption("--quick", nargs="?", const="", metavar="FILES", help="no slow tests but those of these files")


def pytest_collection_modifyitems(config, items):
    lines = SLOW.read_text(encoding="utf-8").splitlines() if SLOW.exists() else []
    slow = {line.split()[1] for line in lines if not line.startswith("#")}
    for item in items:
        item.user_properties += [("fault", name) for mark in item.iter_markers("fault") for name in mark.args]
        if item.nodeid.partition("[")[0] in slow:
            item.add_marker("slow")
    quick = config.getoption("--quick")
    if quick is not None:
        left = [item for item in items if item.get_closest_marker("slow") and item.path.name not in quick.split()]
        config.hook.pytest_deselected(items=left)
        items[:] = [item for item in items if item not in left]


def processor_seconds():
    """Of this process and of those that it has started and that have ended."""
    if sys.platform == "win32":
        return time.process_time()
    used = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item):
    item.stash[BEGAN] = processor_seconds()
    return (yield)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_teardown(item):
    try:
        return (yield)
    finally:
        item.user_properties.append(("cpu", round(processor_seconds() - item.stash[BEGAN], 3)))
