# SPDX-License-Identifier: GPL-3.0-or-later
"""Faults: which of tests/faults.toml a test shows goes into pytest's report, from which docs/reliability.md is made."""


def pytest_collection_modifyitems(items):
    for item in items:
        item.user_properties += [("fault", name) for mark in item.iter_markers("fault") for name in mark.args]
