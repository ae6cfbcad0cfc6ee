# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamorph: dynamic morph targets for Blender. Registration only.

The compiled engine is imported when it is first used (see jobs.engine), so that the add-on can say what is missing.
"""

import bpy

from . import cli, operators, panels, properties

MODULES = (properties, operators, panels)
_commands = []  # handles that Blender wants back


def register():
    for module in MODULES:
        module.register()
    _commands.append(bpy.utils.register_cli_command("dynamorph", cli.main))


def unregister():
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for module in reversed(MODULES):
        module.unregister()
