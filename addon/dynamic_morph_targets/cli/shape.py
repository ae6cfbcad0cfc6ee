# SPDX-License-Identifier: GPL-3.0-or-later
"""The subcommand that lets physics sculpt a target."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import bpy
import numpy as np

from ..core.errors import InputError
from ..run.bake import batch
from ..run.tools import shaping
from ..run.work.task import Task
from ..scene.motion import rig_motion
from ..write.authoring import targets
from . import names
from .commands import save
from .help import without_buttons
from .parsers import name_of
from .record import ProgressPrinter


def add_shape(command: Callable[..., argparse.ArgumentParser]) -> None:
    shape = command("shape", run_shape, "let physics sculpt a target: soft tissue that is bent into its pose")
    shape.add_argument("--target", required=True, type=name_of, metavar="NAME", help="a target; it keeps its pose")
    shape.add_argument("--frame", type=int, metavar="N", help="make a new target of that name, for the pose at a frame")


def run_shape(args: argparse.Namespace) -> None:
    tick = ProgressPrinter()
    for obj in names.objects(args):
        if args.frame is None:
            target = names.target(obj, args.target, "--target")
            if target == obj.dynamorph.targets[0]:
                raise InputError(f"--target: '{target.name}' is the neutral target of '{obj.name}': give another one")
            skeleton = rig_motion.current_pose(obj)[0]
            pose = skeleton, target.local(skeleton), np.array(target.rig_world).reshape(4, 4)
        else:
            keys = obj.data.shape_keys
            if args.target in {*obj.dynamorph.targets.keys(), *(keys.key_blocks.keys() if keys else ())}:
                raise InputError(f"--target: '{obj.name}' has '{args.target}' already: give a new name, or no --frame")
            bpy.context.scene.frame_set(args.frame)
            pose, other = targets.posed_target(obj)
            if other:
                raise InputError(
                    f"--frame: '{obj.name}' is in the pose of '{other.name}' there: name that target alone"
                )
        work = Task(obj, "SHAPE", shaping.shape(obj.session_uid, pose[1]))
        batch.run_all(work, tick)
        for warning in shaping.write(obj, pose, args.target, work.result):
            print(f"{obj.name}: warning: {without_buttons(warning)}", file=sys.stderr, flush=True)
    save(args)
