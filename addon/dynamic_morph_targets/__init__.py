# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamorph: dynamic morph targets for Blender. Registration only.

Imports wait until `register`: core and io then serve and are tested without Blender. The
compiled engine is imported when it is first used (see core.engine), so that the add-on can say what is missing.
"""

_registered: list = []  # modules, in the order in which they were registered
_commands: list = []  # handles that Blender wants back


def _modules():
    from . import preferences
    from .run import live, watch, weight_curves
    from .scene import properties
    from .ui import languages
    from .ui.operators import (
        attachments,
        bake_options,
        collision,
        compare,
        drags,
        export,
        feel,
        grab,
        jobs,
        materials,
        painting,
        playback,
        poses,
        presets,
        sculpting,
        setup,
        targets,
        transfer,
        weights,
    )
    from .ui.overlays import hands, viewport
    from .ui.panels import sections

    return (
        languages,
        preferences,
        properties,
        jobs,
        bake_options,
        setup,
        painting,
        attachments,
        collision,
        targets,
        poses,
        sculpting,
        materials,
        transfer,
        weights,
        playback,
        grab,
        drags,
        compare,
        feel,
        export,
        presets,
        watch,
        weight_curves,
        live,
        viewport,
        hands,
        sections,
    )


def register():
    import bpy

    from .cli import main
    from .core import blas

    def run_command(arguments):
        blas.use_one_thread()  # not where the artist and other add-ons work
        return main.main(arguments)

    try:
        for module in _modules():
            _registered.append(module)  # first, so that what it leaves when it fails is taken back too
            module.register()
        _commands.append(bpy.utils.register_cli_command("dynamorph", run_command))
    except BaseException:
        unregister()
        raise


def unregister():
    """Takes back what `register` has done, however far it came; a second time there is nothing left to do.

    Each module's own `unregister` takes back what there is of it, for the same reason.
    """
    import bpy

    from .core import logger

    while _commands:
        command = _commands.pop()
        if not bpy.app.module:  # in the wheel nobody can call it, and without it bpy 4.5 waits forever as Python ends
            bpy.utils.unregister_cli_command(command)
    while _registered:
        module = _registered.pop()
        try:
            module.unregister()
        except Exception as bug:  # the others are to go all the same
            logger.log_bug(bug)
