# SPDX-License-Identifier: GPL-3.0-or-later
"""The version of the project, which stands in pyproject.toml; the other files of PLACES say the same.

python tools/version.py              prints it; fails where the files differ
python tools/version.py 0.2.0        opens that version in CHANGELOG.md, or if it is open already, dates it
"""

from __future__ import annotations

import re
import sys
from datetime import UTC, datetime
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# The text around each version.
PLACES = {
    "pyproject.toml": [r'^version = "{}"$'],
    "addon/pyproject.toml": [r'^version = "{}"$', r'"dynamorph=={}"'],
    "addon/dynamic_morph_targets/blender_manifest.toml": [r'^version = "{}"$'],
}
HEADING = re.compile(r"^## (\d+\.\d+\.\d+), (unreleased|\d{4}-\d\d-\d\d)$", re.MULTILINE)


def found(root: Path = ROOT) -> dict[str, list[str]]:
    """The versions that each file names; of CHANGELOG.md that of the first heading."""
    versions = {
        name: [version for text in texts for version in pattern(text).findall((root / name).read_text("utf-8"))]
        for name, texts in PLACES.items()
    }
    heading = HEADING.search((root / "CHANGELOG.md").read_text("utf-8"))
    return versions | {"CHANGELOG.md": [heading[1]] if heading else []}


def pattern(text: str) -> re.Pattern:
    return re.compile(text.replace("{}", r"(\d+\.\d+\.\d+)"), re.MULTILINE)


def set_all(new: str, root: Path = ROOT) -> None:
    """Write the version everywhere. Raises ValueError for what is not one, and for one that has been released."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", new):
        raise ValueError(f"'{new}' is not a version: three numbers are, as 0.2.0")
    changelog = root / "CHANGELOG.md"
    changes = changelog.read_text("utf-8")
    heading = HEADING.search(changes)
    if heading is None:
        raise ValueError("CHANGELOG.md has no heading such as '## 0.2.0, unreleased'")
    for version, date in HEADING.findall(changes):
        if date != "unreleased" and numbers(new) <= numbers(version):
            raise ValueError(f"{version} was released on {date}: the next version is a later one")
    if heading[2] == "unreleased":
        changes = changes.replace(heading[0], f"## {new}, {datetime.now(UTC).date()}", 1)
    else:
        changes = changes.replace(heading[0], f"## {new}, unreleased\n\n{heading[0]}", 1)
    for name, texts in PLACES.items():
        content = (root / name).read_text("utf-8")
        for text in texts:
            content = pattern(text).sub(lambda match: match[0].replace(match[1], new), content)
        (root / name).write_text(content, "utf-8")
    changelog.write_text(changes, "utf-8")


def numbers(version: str) -> list[int]:
    return [int(number) for number in version.split(".")]


def one() -> str:
    """The version of all files. Ends the program when they name several."""
    versions = found()
    if len({version for each in versions.values() for version in each}) != 1 or not all(versions.values()):
        named = ", ".join(f"{name}: {' '.join(each)}" for name, each in versions.items())
        sys.exit(f"These are not of one version; make version fixes that: {named}")
    return versions["pyproject.toml"][0]


def main() -> None:
    if len(sys.argv) > 1:
        try:
            set_all(sys.argv[1])
        except ValueError as error:
            sys.exit(f"version: {error}")
    print(one())


if __name__ == "__main__":
    main()
