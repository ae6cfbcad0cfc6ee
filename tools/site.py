# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation as a website in build/site/html: the pages of docs/, references of the Python package and of the
C++ headers, and the playground, if build/playground has one.

python tools/site.py            builds it
python tools/site.py --serve    and serves it to this machine, at the address that it prints
"""

from __future__ import annotations

import argparse
import functools
import http.server
import itertools
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BUILD = ROOT / "build/site"
SOURCE, HTML, DOXYGEN = BUILD / "source", BUILD / "html", BUILD / "doxygen"
PLAYGROUND = ROOT / "build/playground"
PROJECT = ("CHANGELOG.md", "CONTRIBUTING.md", "LICENSES.md", "SECURITY.md", "SUPPORT.md")  # pages beside docs/
HEADERS = {  # the folders of cpp/dynamorph, in the order in which a program meets them
    "mesh": "Meshes",
    "models": "Bodies, targets and unreduced models",
    "elastic": "Elasticity and linear algebra",
    "reduced": "Reduced models",
    "pose": "Poses and skinning",
    "step": "Time steps and limits",
    "contact": "Contact",
    "file": "Files",
    "core": "Basics",
}
INTERNAL = ("_kernels", "_arithmetic", "bone_pairs", "limited_tissue")  # headers that only the engine includes


def assemble() -> None:
    """What Sphinx reads: docs/, the project's own pages, and the sources of the references."""
    shutil.rmtree(BUILD, ignore_errors=True)
    shutil.copytree(ROOT / "docs", SOURCE)
    shutil.copytree(ROOT / "site", SOURCE, ignore=shutil.ignore_patterns("playground"), dirs_exist_ok=True)
    (SOURCE / "project").mkdir()
    for name in PROJECT:
        shutil.copy2(ROOT / name, SOURCE / "project")
    write_stubs(BUILD / "python/dynamorph")
    write_header_pages(SOURCE / "cpp")


def write_stubs(folder: Path) -> None:
    """The Python package as the reference reads it: its stubs, with short names of types."""
    package = ROOT / "cpp/bindings/dynamorph"
    shutil.copytree(package, folder, ignore=shutil.ignore_patterns("__pycache__"))
    init = folder / "__init__.py"
    for part in ("meshing", "model_file"):  # what is public of them is in the package itself
        (folder / f"{part}.py").rename(folder / f"_{part}.py")
        init.write_text(init.read_text("utf-8").replace(f"dynamorph.{part}", f"dynamorph._{part}"), "utf-8")
    stub = folder / "_core.pyi"
    text = stub.read_text("utf-8")
    for pattern, short in (
        (r"typing\.Annotated\[numpy\.typing\.ArrayLike(?:, [^\]\[]*(?:\"[^\"]*\")?)?\]", "ArrayLike"),
        (r"typing\.Annotated\[numpy\.typing\.NDArray\[numpy\.(\w+)\](?:, \"[^\"]*\")?\]", r"NDArray[\1]"),
        (r"numpy\.typing\.NDArray\[numpy\.(\w+)\]", r"NDArray[\1]"),
        (r"collections\.abc\.|typing\.(?=Supports)", ""),
    ):
        text = re.sub(pattern, short, text)
    stub.write_text(text, "utf-8")


def write_header_pages(folder: Path) -> None:
    """A page for each folder of the engine's headers, and their list. Without what only the engine itself includes."""
    folder.mkdir()
    if missing := {each.name for each in (ROOT / "cpp/dynamorph").iterdir()} - {*HEADERS, "simd"}:
        raise ValueError(f"HEADERS lacks {missing}")
    for name, title in HEADERS.items():
        headers = sorted((ROOT / "cpp/dynamorph" / name).rglob("*.hpp"))
        public = [each for each in headers if not each.stem.endswith(INTERNAL)]
        (folder / f"{name}.md").write_text("\n\n".join([f"# {title}", *map(header_section, public)]), "utf-8")
    listed = "\n".join(HEADERS)
    (folder / "index.md").write_text(
        "# C++ reference\n\nThe headers of the engine, a page for each folder of `cpp/dynamorph`. "
        "[The engine in a C++ program](../cpp.md) says how to compile and link it.\n\n"
        f"```{{toctree}}\n:titlesonly:\n\n{listed}\n```\n",
        "utf-8",
    )


def header_section(header: Path) -> str:
    """What a header says of itself at its head, and all that it declares."""
    lines = itertools.takewhile(lambda line: line.startswith("//"), header.read_text("utf-8").splitlines()[1:])
    about = "\n".join(line.removeprefix("//").removeprefix(" ") for line in lines)
    about = re.sub(r"(?m)(?:^  .*\n?)+", lambda block: f"\n```text\n{block[0].rstrip()}\n```\n", about)  # equations
    included = f'`#include "{header.relative_to(ROOT / "cpp").as_posix()}"`'
    return f"## {header.stem}\n\n{included}\n\n{about}\n\n```{{doxygenfile}} {header.name}\n```\n"


def drop_details(page: Path) -> None:
    """Leave out of Doxygen's page of a class what is private, and its header, which the website's page names itself."""
    tree = ElementTree.parse(page)
    for parent in tree.iter("compounddef"):
        for child in list(parent):
            kind = child.get("kind", "") if child.tag == "sectiondef" else child.get("prot", "")
            if child.tag == "includes" or kind.startswith("private"):
                parent.remove(child)
    tree.write(page, "utf-8", xml_declaration=True)


def run(*command: str | Path) -> None:
    if code := subprocess.run(command, cwd=ROOT, check=False).returncode:
        sys.exit(code)


def build() -> None:
    assemble()
    run("doxygen", SOURCE / "Doxyfile")
    for page in (DOXYGEN / "xml").glob("*.xml"):
        drop_details(page)
    sphinx = Path(sys.executable).parent / "sphinx-build"
    run(sphinx, "-q", "-n", "-W", "--keep-going", "-b", "html", "-d", BUILD / "doctrees", SOURCE, HTML)
    if PLAYGROUND.exists():
        shutil.copytree(PLAYGROUND, HTML / "playground")
    else:
        print("The playground is missing: make playground")
    print(HTML.relative_to(ROOT) / "index.html")


def serve() -> None:
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=HTML)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        print(f"http://127.0.0.1:{server.server_port}/  (Ctrl-C ends it)", flush=True)
        server.serve_forever()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--serve", action="store_true")
    named = parser.parse_args()
    build()
    if named.serve:
        serve()
