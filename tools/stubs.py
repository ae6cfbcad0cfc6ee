# SPDX-License-Identifier: GPL-3.0-or-later
"""pybind11-stubgen on a compiled module as it is, without what the package adds to its classes; with its arguments."""

import sys
import types
from importlib.util import find_spec

from pybind11_stubgen import main

spec = find_spec("dynamorph")
assert spec and spec.submodule_search_locations
sys.modules["dynamorph"] = types.ModuleType("dynamorph")
sys.modules["dynamorph"].__path__ = spec.submodule_search_locations
main()
