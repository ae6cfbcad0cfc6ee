# SPDX-License-Identifier: GPL-3.0-or-later
"""How Sphinx makes the website. tools/site.py puts the pages beside this file first."""

import re
import shutil
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]  # HERE is build/site/source
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
BLENDS = (ROOT / "dist/recipes", ROOT / "dist/gallery")  # whose files can be downloaded where a page names them
BRANCHES = {  # pages, and how they link to what is below them
    "recipes/index": r"\]\((\w+)\.md",
    "panels/index": r"\]\((\w+)\.md",
    "measurements": r"^- \[[^\]]+\]\((\w+)\.md",
}
REPOSITORY = PROJECT.get("urls", {}).get("Repository", "")

project = "Dynamorph"
author = "The Dynamorph developers"
copyright = "The Dynamorph developers, GPL-3.0-or-later"
release = PROJECT["version"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "autoapi.extension", "breathe"]
exclude_patterns = ["static"]
myst_heading_anchors = 4
suppress_warnings = [
    "autoapi.python_import_resolution",
    "duplicate_declaration.cpp",  # each header opens the same namespace
]

autoapi_dirs = [str(HERE.parent / "python")]
autoapi_root = "python_reference"
autoapi_options = ["members", "imported-members", "show-module-summary"]
autoapi_add_toctree_entry = False
autoapi_python_class_content = "both"
autoapi_member_order = "bysource"
autodoc_typehints = "signature"
breathe_projects = {"dynamorph": str(HERE.parent / "doxygen/xml")}
breathe_default_project = "dynamorph"
breathe_default_members = ("members",)
cpp_index_common_prefix = ["dynamorph::"]
nitpick_ignore_regex = [("cpp:.*", ".*"), ("py:.*", ".*")]  # types of NumPy, Eigen and the standard library

html_theme = "furo"
html_title = f"Dynamorph {release}"
html_static_path = ["static"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True}


def link_out_of_docs(app, name, source):
    """Links to files beside docs/: the project's own pages are pages here too, other files can be downloaded, and a
    folder is at the project's repository, once that has an address. The .blend files of recipes and gallery become
    downloads where they are named, if they have been made."""
    up = "../" * name.count("/")

    def replaced(match):
        text, path = match[1], match[2]
        target = (ROOT / "docs" / name).parent.joinpath(path) if not name.startswith("project/") else ROOT / path
        target = target.resolve()
        if not target.is_relative_to(ROOT) or not target.exists():
            return match[0]
        place = target.relative_to(ROOT)
        if place.parts[0] == "docs":
            return f"[{text}]({up}{place.relative_to('docs').as_posix()}{match[3] or ''})"
        if (HERE / "project" / place).exists():
            return f"[{text}]({up}project/{place}{match[3] or ''})"
        if target.is_file():
            copy = HERE / "files" / place
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(target, copy)
            return f"[{text}]({up}files/{place.as_posix()})"
        at = place.as_posix()
        return f"[{text}]({REPOSITORY}/tree/main/{at})" if REPOSITORY else f"{text} (`{at}`)"

    def download(match):
        found = next((folder / match[1] for folder in BLENDS if (folder / match[1]).exists()), None)
        if not found:
            return match[0]
        (HERE / "files").mkdir(exist_ok=True)
        shutil.copy2(found, HERE / "files")
        return f"[{match[1]}]({up}files/{match[1]})"

    if not name.startswith(("python_reference", "cpp/")):
        source[0] = re.sub(r"`(\w+\.blend)`", download, source[0])
        source[0] = re.sub(r"(?<!!)\[([^\]]+)\]\(((?!\w+:)[^)#\s]+)(#[^)\s]*)?\)", replaced, source[0])


def list_below(app, name, source):
    """A page of BRANCHES has the pages that it lists below it in the navigation, in its order."""
    if name in BRANCHES:
        pages = dict.fromkeys(re.findall(BRANCHES[name], source[0], re.MULTILINE))
        source[0] += "\n\n```{toctree}\n:hidden:\n:titlesonly:\n\n" + "\n".join(pages) + "\n```\n"


def plain_docstrings(app, what, name, obj, options, lines):
    """Docstrings are plain text: names in backticks become code, and nothing else is markup."""
    lines[:] = [re.sub(r"`([^`]+)`", r"``\1``", re.sub(r"([|*])", r"\\\1", line)) for line in lines]


def setup(app):
    app.connect("autodoc-process-docstring", plain_docstrings)
    app.connect("source-read", list_below)
    app.connect("source-read", link_out_of_docs)
