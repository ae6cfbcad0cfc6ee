# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamorph: dynamic morph targets for Blender. Registration only.

Imports wait until `register`: core and io then serve and are tested without Blender. The
compiled engine is imported when it is first used (see core.engine), so that the add-on can say what is missing.
"""

from functools import partial
from types import ModuleType


def _modules() -> tuple[ModuleType, ...]:
    from . import preferences
    from .run import live
    from .run.tools import watch, weight_curves
    from .scene.properties import object_properties as properties
    from .ui import languages
    from .ui.operators import (
        attachments,
        bake_options,
        channels,
        collision,
        compare,
        export,
        feel,
        grab,
        grips,
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
        channels,
        sculpting,
        materials,
        transfer,
        weights,
        playback,
        grab,
        grips,
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


def register() -> None:
    import bpy

    from .cli import main
    from .core import blas
    from .scene import registration

    def run_command(arguments: list[str]) -> int:
        blas.use_one_thread()  # not where the artist and other add-ons work
        return main.main(arguments)

    try:
        for module in _modules():
            registration.later(__name__, partial(_unregister, module))  # first: it is taken back too when it fails
            module.register()
        command = bpy.utils.register_cli_command("dynamorph", run_command)
        if not bpy.app.module:  # in the wheel nobody can call it, and without it bpy 4.5 waits forever as Python ends
            registration.later(__name__, partial(bpy.utils.unregister_cli_command, command))
    except BaseException:
        unregister()
        raise


def unregister() -> None:
    """Takes back what `register` has done, however far it came; a second time there is nothing left to do.

    Each module's own `unregister` takes back what there is of it, for the same reason.
    """
    from .scene import registration

    registration.take_back(__name__)


def _unregister(module: ModuleType) -> None:
    from .core import logger

    try:
        module.unregister()
    except Exception as bug:  # the others are to go all the same
        logger.log_bug(bug)
