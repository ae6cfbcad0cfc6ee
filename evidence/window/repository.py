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
    """What Repositories > + > Add Remote Repository does with the URL; the dialog is Blender's own."""
    url = (WORK / "repository/index.json").as_uri()
    with viewport.context():
        bpy.ops.preferences.extension_repo_add("EXEC_DEFAULT", type="REMOTE", remote_url=url, name=MODULE)
    yield from until(lambda: repository() >= 0, "the repository in the preferences")


@step("Refresh, and install from it")
def install_from_it():
    began, system = time.monotonic(), bpy.context.preferences.system
    system.use_online_access = True  # which Blender asks for even where the repository is a file
    with viewport.context():
        bpy.ops.extensions.repo_sync(repo_index=repository())  # waits, or the list would still be locked
        bpy.ops.extensions.package_install("INVOKE_DEFAULT", repo_index=repository(), pkg_id=ID, enable_on_install=True)
    yield from until(lambda: ADDON in bpy.context.preferences.addons, "the extension to be installed and enabled", 60)
    yield from until(lambda: not driver.window().modal_operators, "the end of the operator")
    system.use_online_access = False
    measure("Installed from a repository", f"{time.monotonic() - began:.0f} s")


@step("Uninstall")
def uninstall():
    with viewport.context():
        bpy.ops.extensions.package_uninstall("INVOKE_DEFAULT", repo_index=repository(), pkg_id=ID)
    yield from until(lambda: ADDON not in bpy.context.preferences.addons, "the extension to be gone")
    assert not hasattr(bpy.types.Object, "dynamorph")
    repos = bpy.context.preferences.extensions.repos
    yield from until(lambda: not Path(repos[repository()].directory, ID).exists(), "its files to be gone")
    yield from until(lambda: not driver.window().modal_operators, "the end of the operator")
    repos.remove(repos[repository()])  # the zip is for another one
