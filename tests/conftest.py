# SPDX-License-Identifier: GPL-3.0-or-later
"""For all tests: what fails is named at once. Which faults of tests/faults.toml a test shows goes into pytest's report,
from which docs/reliability.md is made.
"""

import subprocess

import pytest


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


def pytest_collection_modifyitems(items):
    for item in items:
        item.user_properties += [("fault", name) for mark in item.iter_markers("fault") for name in mark.args]
