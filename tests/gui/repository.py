# SPDX-License-Identifier: GPL-3.0-or-later
"""Installs the extension from a repository, as Blender's Get Extensions does, and removes it again."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import driver
from driver import WORK, measure, step, until
from editors import viewport

ID, MODULE = "dynamic_morph_targets", "dynamorph_repository"
ADDON = f"bl_ext.{MODULE}.{ID}"


def repository() -> int:
    """The number of the repository in the preferences; -1 if it is not there."""
    return bpy.context.preferences.extensions.repos.find(MODULE)


@step("Add the remote repository")
def add_repository():
    """The dialog of Repositories > + > Add Remote Repository, with the URL filled in."""
    bpy.context.preferences.system.use_online_access = True
    url = (WORK / "repository/index.json").as_uri()
    yield from driver.move(viewport.middle)
    with viewport.context():
        bpy.ops.preferences.extension_repo_add("INVOKE_DEFAULT", type="REMOTE", remote_url=url, name=MODULE)
    yield from driver.drawn()
    yield from viewport.key("RET")
    yield from until(lambda: repository() >= 0, "the repository in the preferences")


@step("Refresh, and install from it")
def install_from_it():
    began = time.monotonic()
    with viewport.context():
        bpy.ops.extensions.repo_sync("INVOKE_DEFAULT", repo_index=repository())
        folder = Path(bpy.context.preferences.extensions.repos[repository()].directory)
        yield from until(lambda: (folder / ".blender_ext/index.json").exists(), "the list of the repository")
        bpy.ops.extensions.package_install("INVOKE_DEFAULT", repo_index=repository(), pkg_id=ID, enable_on_install=True)
    yield from until(lambda: ADDON in bpy.context.preferences.addons, "the extension to be installed and enabled", 60)
    measure("Installed from a repository", f"{time.monotonic() - began:.0f} s")


@step("Uninstall")
def uninstall():
    with viewport.context():
        bpy.ops.extensions.package_uninstall("INVOKE_DEFAULT", repo_index=repository(), pkg_id=ID)
    yield from until(lambda: ADDON not in bpy.context.preferences.addons, "the extension to be gone")
    assert not hasattr(bpy.types.Object, "dynamorph")
    repos = bpy.context.preferences.extensions.repos
    repos.remove(repos[repository()])
