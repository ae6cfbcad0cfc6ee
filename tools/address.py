# SPDX-License-Identifier: GPL-3.0-or-later
"""The public addresses of the project, which stand in pyproject.toml as project.urls: `Repository` on the code host and
`Homepage`, the site. Every file that shows them has a block between two comments, which this script writes.

python tools/address.py         writes all blocks; without addresses they say that there is none yet
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"((?:<!--|#) address: tools/address\.py [^\n]*\n).*?((?:<!--|#) end of address)", re.DOTALL)


def texts(urls: dict[str, str]) -> dict[str, str]:
    """What each file says between its comments."""
    if not urls:
        return {
            "README.md": "Nothing is published yet: downloads will be on the project's release page, and Blender will "
            "install and update\nDynamorph from an address that will be printed here. Until then, one command on Linux"
            "\n[builds the zip](docs/install.md#build-the-zip), for Windows and macOS too.\n",
            "docs/install.md": "Dynamorph's repository is not public yet; its address will be printed here. Until then,"
            " [build the zip](#build-the-zip)\nor [serve a repository of your own](#serve-a-repository).\n",
            "SUPPORT.md": "The project has no public address yet. Issues will be on its code host, where the forms ask "
            "for what is listed below.\n",
            "addon/pyproject.toml": "",
            "addon/dynamic_morph_targets/blender_manifest.toml": "",
        }
    site, repository = urls["Homepage"].rstrip("/"), urls["Repository"].rstrip("/")
    extensions = f"{site}/repository/index.json"  # as the release workflow publishes it
    zips = f"Zips of every version are on the [release page]({repository}/releases).\n"
    return {
        "README.md": "In Blender, choose *Edit > Preferences > Get Extensions > Repositories > + > Add Remote "
        f"Repository*, enter\n`{extensions}`, then find *Dynamorph* and press *Install*. {zips}\n"
        f"Documentation and playground: <{site}>\n",
        "docs/install.md": f"The address is `{extensions}`. {zips}",
        "SUPPORT.md": f"Report it as an issue: <{repository}/issues>\n",
        "addon/pyproject.toml": "\n".join(["[project.urls]", *(f'{key} = "{urls[key]}"' for key in urls), ""]),
        "addon/dynamic_morph_targets/blender_manifest.toml": f'website = "{site}"\n',
    }


def written(root: Path) -> dict[Path, str]:
    """Each file as it should be."""
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    files = {}
    for name, text in texts(project.get("urls", {})).items():
        parts = BLOCK.subn(lambda block, text=text: block[1] + text + block[2], (root / name).read_text("utf-8"))
        if parts[1] != 1:
            raise ValueError(f"{name} has {parts[1]} blocks for the address, not one")
        files[root / name] = parts[0]
    return files


def main(root: Path = ROOT) -> None:
    for path, text in written(root).items():
        path.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
