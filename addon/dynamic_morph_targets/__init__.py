# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamorph: dynamic morph targets for Blender. Registration only.

Imports wait until `register`: the modules between extract and sinks then serve and are tested without Blender. The
compiled engine is imported when it is first used (see jobs.engine), so that the add-on can say what is missing.
"""

import atexit

_commands = []  # handles that Blender wants back


def _modules():
    from . import (
        export_operators,
        feel_operators,
        influence,
        influence_operators,
        live,
        live_operators,
        operators,
        overlays,
        panels,
        piece_operators,
        preferences,
        presets,
        properties,
        setup_operators,
        target_operators,
        transfer_operators,
        watch,
    )

    buttons = operators, setup_operators, piece_operators, target_operators, transfer_operators, influence_operators
    return (
        preferences,
        properties,
        *buttons,
        live_operators,
        feel_operators,
        export_operators,
        presets,
        influence,
        live,
        watch,
        overlays,
        panels,
    )


def register():
    import bpy

    from . import cli

    for module in _modules():
        module.register()
    _commands.append(bpy.utils.register_cli_command("dynamorph", cli.main))
    if bpy.app.module:
        atexit.register(unregister)  # the wheel does not do it, and then crashes or hangs while Python ends


def unregister():
    import bpy

    if not _commands:  # done by atexit: the wheel, as it ends, disables its add-ons once more
        return
    atexit.unregister(unregister)
    while _commands:
        bpy.utils.unregister_cli_command(_commands.pop())
    for module in reversed(_modules()):
        module.unregister()
