# SPDX-License-Identifier: GPL-3.0-or-later
"""What --help and --version print beside the options."""

from __future__ import annotations

import argparse
import re
from typing import NoReturn

import bpy

from ..core import engine

EXAMPLES = {
    "check": "--all",
    "bake": "--object Body -o baked.blend",
    "build": "--all --cache-dir models",
    "report": "--object Body --json figures.json",
    "fit": "--object Body --target Flexed --oscillation swing.csv --in-place",
    "shape": "--object Body --target Flexed --in-place",
    "collect": "reports -o index.html --expect 12",
    "delete-bake": "--all --in-place",
    "info": "--all",
}


# What a message tells an artist to do, and what does it here.
INSTEAD = {
    "press Build Model": "run dynamorph build",
    "press Bake": "run dynamorph bake",
    "press Delete Bake": "run dynamorph delete-bake",
    "press Add Soft Skin": "press Add Soft Skin in Blender",
}


def without_buttons(text: str) -> str:
    """A message in the words of the command line."""
    return re.sub(rf"\b({'|'.join(INSTEAD)})\b(?! in Blender)", lambda found: INSTEAD[found[1]], text)


class Parser(argparse.ArgumentParser):
    """It says what is wrong in one line, without all options."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: error: {message} ({self.prog} --help lists what there is)\n")


class Version(argparse.Action):
    """Prints the versions and ends."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        found = engine.engine_problem() or engine.installed_version() or "as compiled here"
        print(f"Dynamorph {engine.addon_version()}, engine {found}, Blender {bpy.app.version_string}")
        parser.exit()


def epilog(command: str, opens_file: bool) -> str:
    """What --help ends with."""
    start = "blender -b shot.blend -c dynamorph {}"
    if opens_file:
        start = "python -m dynamic_morph_targets {}" + " shot.blend" * (command != "collect")
    return f"""\
example:
  {start.format(command)} {EXAMPLES[command]}

Settings that are not given stay as they are in the .blend.

exit codes:
  0    done
  2    bad input: trying again does not help
  3    the result failed its check
  70   a bug in Dynamorph
  75   a disk, network or memory fault, or stopped by a signal: try again
  130  interrupted"""


def add_parser(commands: argparse._SubParsersAction, opens_file: bool, name: str, text: str) -> argparse.ArgumentParser:
    end, raw = epilog(name, opens_file), argparse.RawDescriptionHelpFormatter
    sub: argparse.ArgumentParser = commands.add_parser(
        name, help=text, description=text, epilog=end, formatter_class=raw
    )
    return sub
