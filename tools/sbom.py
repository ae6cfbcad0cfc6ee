# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of what is compiled into a wheel of the engine, in CycloneDX's format (PEP 770)."""

from __future__ import annotations

import re
import subprocess
import uuid
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

from cyclonedx.factory.license import LicenseFactory
from cyclonedx.model.bom import Bom
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output import make_outputter
from cyclonedx.schema import OutputFormat, SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

ROOT = Path(__file__).resolve().parent.parent
DEBIAN = {  # a library of headers: one of them, and the license
    "Eigen": ("/usr/include/eigen3/Eigen/Core", "MPL-2.0"),
    "Spectra": ("/usr/include/Spectra/SymEigsSolver.h", "MPL-2.0"),
    "CGAL": ("/usr/include/CGAL/alpha_wrap_3.h", "GPL-3.0-or-later"),
    "Boost": ("/usr/include/boost/version.hpp", "BSL-1.0"),
    "JSON for Modern C++": ("/usr/include/nlohmann/json.hpp", "MIT"),
}


def components(platform: str) -> list[tuple[str, str, str, PackageURL]]:
    """Name, version, license and address of all that is compiled in."""
    pin = re.search(r"^tetgen==(\S+)", (ROOT / "tools/tetgen.txt").read_text(encoding="utf-8"), re.MULTILINE)[1]
    found = [("TetGen", pin, "AGPL-3.0-or-later", PackageURL("pypi", name="tetgen", version=pin))]
    for name, (header, license_id) in DEBIAN.items():
        package = subprocess.check_output(["dpkg-query", "-S", header], text=True).split(":")[0]
        version = subprocess.check_output(["dpkg-query", "-W", "-f", "${Version}", package], text=True)
        found.append((name, version, license_id, PackageURL("deb", "debian", package, version)))
    for name, package, license_id in (
        ("pybind11", "pybind11", "BSD-3-Clause"),
        ("libc++ of Clang", "ziglang", "Apache-2.0 WITH LLVM-exception"),
        *((("MinGW-w64 runtime", "ziglang", "ZPL-2.1"),) if platform.startswith("windows") else ()),
    ):
        version = metadata.version(package)
        found.append((name, version, license_id, PackageURL("pypi", name=package, version=version)))
    return found


def document(version: str, platform: str) -> str:
    """The list as JSON, valid by CycloneDX's schema. The same input gives the same bytes."""
    licenses = LicenseFactory()
    engine = Component(
        name="dynamorph", version=version, type=ComponentType.LIBRARY, bom_ref="dynamorph",
        licenses=[licenses.make_from_string("GPL-3.0-or-later")],
    )  # fmt: skip
    bom = Bom(serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"dynamorph-{version}-{platform}"))
    bom.metadata.component = engine
    bom.metadata.timestamp = datetime.fromtimestamp(0, UTC)
    parts = []
    for name, number, license_id, address in components(platform):
        terms = [licenses.make_from_string(license_id)]
        kind = ComponentType.LIBRARY
        parts.append(Component(name=name, version=number, type=kind, bom_ref=name, purl=address, licenses=terms))
        bom.components.add(parts[-1])
    bom.register_dependency(engine, parts)
    text = make_outputter(bom, OutputFormat.JSON, SchemaVersion.V1_6).output_as_string(indent=1)
    if error := JsonStrictValidator(SchemaVersion.V1_6).validate_str(text):
        raise ValueError(f"the list of components is not valid: {error}")
    return text
