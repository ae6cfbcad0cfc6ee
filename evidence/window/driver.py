# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands, eyes and a list of steps for a test inside a Blender window; see scenario.py.

A step is a generator: `yield seconds` lets Blender handle events and draw, `yield 0` for one turn of its main loop.
Whatever moves the mouse or waits is a generator too, called with `yield from`:

    @step("Bake", picture=sidebar)                                    # the guide's picture bake.png
    def bake():
        yield from sidebar.press("dynamorph.bake")                    # an operator, wherever its button is
        yield from sidebar.enter("simulation.substeps", "20")         # the end of a property's path
        yield from until(lambda: not jobs().running, "the bake")
        assert ...
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
import traceback
from pathlib import Path

import bpy
import numpy as np

_WORK, PART = sys.argv[sys.argv.index("--") + 1 :]  # the part is the name of the module with its steps
WORK = Path(_WORK)
ROW = 16  # less than a button's height: none is missed
HEADER = 26  # pixels: from one closed section's header to the next
SLIDE = 0.35  # seconds: a section slides open or shut for 0.3, and with it all below
ASIDE = 90  # pixels from the left: a header, and of a list neither the button nor the handle at its bottom
END = 500  # no buttons for so many pixels: there are none below
AROUND = 350  # pixels: where of a button that which it opens is looked for
OPENS = 1500  # pixels that change outside of a button when something opens
COLUMNS = (0.45, 0.75, 0.86, 0.91, 0.2, 0.6)  # across a region: buttons, fields, beside a list (two), halves of a row

result = {"ok": False, "steps": [], "measured": {}, "pictures": [], "numbered": {}}
actions = 0  # clicks, keys and entries so far, as an artist counts them
scrolls = 0  # how often a button was out of sight
shown: set[str] = set()  # the panels of the extension that have drawn since it was emptied
there: set[str] = set()  # what opens: names of a class, an operator, a section, or a property with its type
opened: set[str] = set()  # of these


def window():
    return bpy.context.window_manager.windows[0]


def measure(name: str, value: str):
    """A line of the table that the test prints."""
    result["measured"][name] = value


class Task:
    """What an artist wants, in so many actions at most and without scrolling: from here on until it is `done`."""

    def __init__(self, name: str, most: int):
        self.name, self.most = name, most
        self.actions, self.scrolls = actions, scrolls

    def done(self):
        taken = actions - self.actions
        measure(f"Actions: {self.name}", f"{taken} of at most {self.most}")
        assert taken <= self.most and scrolls == self.scrolls, f"{self.name}: {taken} actions, {scrolls} out of sight"


def until(condition, what: str, limit=20.0):
    """Wait until `condition()` is true, and return its value."""
    end = time.monotonic() + limit
    while not (value := condition()):
        if time.monotonic() > end:
            raise AssertionError(f"waited {limit:g} s in vain for {what}")
        yield 0
    return value


# Hands ---------------------------------------------------------------------------------------------------------------


NUMBERS = ("ZERO", "ONE", "TWO", "THREE", "FOUR", "FIVE", "SIX", "SEVEN", "EIGHT", "NINE")
KEYS = {str(i): name for i, name in enumerate(NUMBERS)} | {".": "PERIOD", "-": "MINUS"}  # of a number's letters


def send(kind: str, value: str, position, **details):
    x, y = position
    window().event_simulate(type=kind, value=value, x=int(x), y=int(y), **details)


def move(position):
    send("MOUSEMOVE", "NOTHING", position)
    yield 0  # now the button that it was over is left
    yield 0  # now it is over another


def rest():
    """The mouse where it lights nothing up and no tooltip comes."""
    yield from move((window().width // 2, 2))


def tap(kind: str, position, **details):
    send(kind, "PRESS", position, **details)
    yield 0
    send(kind, "RELEASE", position)
    yield 0


def drag(path):
    """A stroke with the left button along positions."""
    global actions
    actions += 1
    yield from move(path[0])
    send("LEFTMOUSE", "PRESS", path[0])
    yield 0.02
    for position in path[1:]:
        send("MOUSEMOVE", "NOTHING", position)
        yield 0.02
    send("LEFTMOUSE", "RELEASE", path[-1])
    yield 0.1


def click(position):
    global actions
    actions += 1
    yield from move(position)
    yield from tap("LEFTMOUSE", position)


# Eyes ----------------------------------------------------------------------------------------------------------------


def drawn(passes=3):
    """Wait until the screen shows the present state."""
    for area in window().screen.areas:
        area.tag_redraw()
    for _ in range(passes):
        yield 0.05


def settled(region: Region):
    """Wait until a region has kept its place for some turns: those around it slide in and out."""
    before, same = None, 0
    while same < 5:
        yield from drawn(passes=1)
        same = same + 1 if region.box == before else 0
        before = region.box


def drawn_smoothly():
    """The same with smooth edges, which take the viewport several passes."""
    bpy.context.preferences.system.viewport_aa = "8"
    yield from drawn(passes=12)
    bpy.context.preferences.system.viewport_aa = "OFF"


def photograph(name: str, box=None):
    """WORK/shots/`name`.png of the screen, or of `box` in it: (x, y, width, height), y from the bottom."""
    x, y, width, height = box or (0, 0, window().width, window().height)
    crop = f"{width}x{height}+{x}+{window().height - y - height}"
    # Blender's own screenshot is black with software OpenGL.
    command = ["import", "-window", "root", "-crop", crop, "+repage", WORK / "shots" / f"{name}.png"]
    subprocess.run(command, check=True)


def pixels(box) -> np.ndarray:
    """What the screen shows in a box as `photograph` takes it: (height, width, 3), from 0 to 1."""
    photograph("pixels", box)
    image = bpy.data.images.load(str(WORK / "shots" / "pixels.png"))
    found = np.array(image.pixels[:], np.float32).reshape(box[3], box[2], 4)[:, :, :3]
    bpy.data.images.remove(image)
    return found


def pop_up(position, name: str):
    """Click what opens something over the window, and wait until it shows. A picture of it is left beside the result.

    name: what it opens, as openings.py names it, which notes by itself that a panel is drawn or that an operator asks.
    """
    x, y = map(int, position)
    left, bottom = max(x - AROUND, 0), max(y - AROUND, 0)
    box = left, bottom, min(x + AROUND, window().width) - left, min(y + AROUND, window().height) - bottom
    yield from move(position)
    yield from drawn()
    before = pixels(box)
    yield from click(position)
    yield from drawn()
    changed = np.abs(pixels(box) - before).max(axis=-1) > 0.05
    row = box[3] - (y - bottom)  # from the top
    changed[row - ROW : row + ROW] = False  # the button itself
    photograph(f"opened_{name}", box)
    assert changed.sum() > OPENS, f"{name} did not open: {changed.sum()} pixels changed"


def drop_down(position, name: str):
    """The same for a property's list, which nobody records when it is drawn."""
    yield from pop_up(position, name)
    opened.add(name)


class Region:
    """A region of the first editor of its kind, looked up each time: layouts and undo replace them.

    Without a kind it is the whole editor, to take pictures of.
    """

    def __init__(self, editor: str, kind: str | None = None):
        self.editor, self.kind = editor, kind
        self.known: dict[str, tuple[float, float]] = {}  # where buttons were seen
        self.headers: dict[str, tuple[float, float]] = {}  # where sections were last opened or closed
        self.shift = 0  # pixels that a button had moved when it was last looked for

    @property
    def area(self):
        return next(area for area in window().screen.areas if area.type == self.editor)

    @property
    def region(self):
        return next(region for region in self.area.regions if region.type == self.kind)

    @property
    def box(self):
        place = self.region if self.kind else self.area
        return place.x, place.y, place.width, place.height

    @property
    def middle(self):
        x, y, width, height = self.box
        return x + width // 2, y + height // 2

    @property
    def ceiling(self):
        return self.box[1] + self.box[3]

    @property
    def top(self):
        return self.middle[0], self.ceiling - 15

    def context(self):
        return bpy.context.temp_override(window=window(), area=self.area, region=self.region)

    def key(self, kind: str, **details):
        """Press a key with the mouse over the middle of the region."""
        global actions
        actions += 1
        yield from move(self.middle)
        yield from tap(kind, self.middle, **details)

    def under_mouse(self) -> str:
        """The button there: 'bpy.ops.a.b()' or the full path of a property, '' without one."""
        manager = bpy.context.window_manager
        manager.clipboard = ""
        with self.context():
            for copy in (
                bpy.ops.ui.copy_python_command_button,
                lambda: bpy.ops.ui.copy_data_path_button(full_path=True),
            ):
                try:
                    copy()
                except RuntimeError:  # poll: not such a button
                    continue
                if manager.clipboard:
                    break
        return manager.clipboard

    def look(self, position):
        """The button at a position, which is remembered."""
        yield from move(position)
        button = self.under_mouse()
        if button:
            self.known[button] = position
        return button

    def seen(self, wanted: str):
        """The remembered position of an operator ("dynamorph.bake") or a property ("model.cage_nodes"), or None."""
        for button, position in self.known.items():
            if is_button(button, wanted):
                return position
        return None

    def find(self, wanted: str):
        """The position of a button, scrolled into view if need be."""
        global scrolls
        if self.seen(wanted) and (yield from self.near(wanted)):
            return self.seen(wanted)
        self.known.clear()
        for columns in (COLUMNS[:1], COLUMNS[1:]):  # the first meets nearly all
            yield from self.scroll("WHEELUPMOUSE", 40)
            down, further = False, True
            while further:
                if (yield from self.scan(wanted, columns)):
                    scrolls += down
                    return self.seen(wanted)
                down = further = yield from self.scroll("WHEELDOWNMOUSE", 6)
        raise AssertionError(f"no button {wanted} in {self.editor}, only {', '.join(self.known) or 'nothing'}")

    def beside(self, wanted: str, neighbor: str):
        """Find a button in the row of another, which is quicker to find."""
        _, row = yield from self.find(neighbor)
        return (yield from self.across(row, wanted))

    def across(self, row: float, wanted: str, columns=COLUMNS):
        """The position of a button in a row, in the first column that meets it."""
        x, _, width, _ = self.box
        for column in columns:
            position = x + int(width * column), row
            if is_button((yield from self.look(position)), wanted):
                return position
        raise AssertionError(f"no button {wanted} in row {row}")

    def near(self, wanted: str):
        """Look where the button was last, then as far from there as the one before it was, then below and above."""
        x, y = self.seen(wanted)
        for offset in sorted({0, *range(-200, 201, ROW)}, key=lambda offset: (offset != 0, abs(offset - self.shift))):
            if is_button((yield from self.look((x, y + offset))), wanted):
                self.shift = offset or self.shift
                return True
        return False

    def scan(self, wanted: str, columns):
        """Move the mouse over the region, from the top, until the wanted button is under it; False without it."""
        x, y, width, height = self.box
        for column in columns:
            last = y + height
            for row in range(y + height - ROW // 2, y, -ROW):
                button = yield from self.look((x + int(width * column), row))
                if is_button(button, wanted):
                    return True
                if button:
                    last = row
                elif last - row > END:
                    break
        return False

    def scroll(self, wheel: str, clicks: int):
        """Turn the wheel; by how many pixels what is shown has moved up."""
        view = self.region.view2d
        _, before = view.view_to_region(0, 0, clip=False)
        yield from move(self.top)
        for _ in range(clicks):
            send(wheel, "PRESS", self.top)
        yield 0.05
        return view.view_to_region(0, 0, clip=False)[1] - before

    def press(self, wanted: str):
        """Click a button."""
        position = yield from self.find(wanted)
        yield from click(position)

    def pop_up(self, operator: str):
        """Click a button that opens a dialog or a menu; returns where it is."""
        position = yield from self.find(operator)
        yield from pop_up(position, operator)
        assert operator in opened, f"{operator} reported something instead"
        return position

    def field(self, wanted: str):
        """(position, owner, name) of a property's button."""
        position = yield from self.find(wanted)
        path = next(button for button in self.known if is_button(button, wanted))
        owner, _, name = path.rpartition(".")
        return position, eval(owner), name  # a path of Blender's, such as bpy.data.objects["Arm"].dynamorph.model

    def choose_other(self, wanted: str):
        """Choose another item in a drop-down than it shows, with the arrow keys, and set it back."""
        position, owner, name = yield from self.field(wanted)
        yield from choose_other(position, owner, name)

    def look_into(self, wanted: str):
        """Open the list of what a field takes, and close it."""
        position, owner, name = yield from self.field(wanted)
        yield from drop_down(position, f"{owner.bl_rna.identifier}.{name}")
        yield from tap("ESC", position)
        yield from drawn()

    def pick(self, x: float, condition, what: str):
        """Click the tab, down a column of them at `x` of the window, after which `condition()` is true: one action."""
        global actions
        actions += 1
        _, y, _, height = self.box
        for row in range(y + height - ROW, y, -ROW):
            yield from move((x, row))
            yield from tap("LEFTMOUSE", (x, row))
            yield 0.05
            if condition():
                return
        raise AssertionError(f"{what} not found in {self.editor}")

    def panels(self):
        """The names of the panels that are open, as openings.py notes them while they draw."""
        shown.clear()
        yield from drawn()
        return frozenset(shown)

    def unfold(self, panel: str):
        """Open a section by a click on its header, unless it is open; returns where the header is."""
        yield from self._toggle(panel, True)
        return self.headers.get(panel)

    def fold(self, panel: str):
        """Close it."""
        yield from self._toggle(panel, False)

    def _toggle(self, panel: str, wanted: bool):
        """A header has no name: it is found by what draws after a click, below the buttons that stay in place."""
        global actions, scrolls
        before = yield from self.panels()
        if (panel in before) == wanted:
            return
        actions += 1
        if panel in self.headers and not (yield from self._try(self.headers[panel], panel, wanted, before)):
            return
        _, top = yield from self.find("dynamorph.delete_bake")
        height = top - ROW
        while True:
            while height > self.box[1] + ROW // 2:
                down = yield from self._try((self.box[0] + ASIDE, height), panel, wanted, before)
                if not down:
                    return
                height -= down
            moved = yield from self.scroll("WHEELDOWNMOUSE", 6)
            if not moved:
                raise AssertionError(f"no section {panel} in {self.editor}")
            scrolls += 1
            height += moved

    def _try(self, place, panel: str, wanted: bool, before: frozenset):
        """Click where a section's header may be; pixels down to the next such place, 0 if this one opened or closed it
        as wanted. Another section is as before.
        """
        if (yield from self.look(place)):
            return ROW // 2
        yield from self._click_header(place)
        now = yield from self.panels()
        parent = getattr(bpy.types, panel).bl_parent_id
        if (panel in now) == wanted and (parent in now) == (parent in before):
            self.headers[panel] = place
            return 0
        if now == before:
            return ROW // 2
        yield from self._put_back(place, before)
        return HEADER

    def _put_back(self, header, before: frozenset):
        """Click a header until the panels are as before: a click while the section still slides is lost."""
        for _ in range(5):
            yield from self._click_header(header)
            if (yield from self.panels()) == before:
                return
        raise AssertionError(f"the section at {header} of {self.editor} stays as it is")

    def _click_header(self, header):
        yield from move(header)
        yield from tap("LEFTMOUSE", header)
        yield SLIDE

    def enter(self, wanted: str, text: str):
        """Type a number into a field."""
        global actions
        actions += 1
        _, row = yield from self.find(wanted)
        yield from drawn()  # a list that has just closed would take the first key
        position = yield from self.across(row, wanted, (0.7, *COLUMNS))  # not on the arrows at the ends of a number
        yield from tap("RET", position)
        yield 0.1
        for letter in text:  # their own keys: A, if the field did not open, would close the panel
            yield from tap(KEYS[letter], position, unicode=letter)
        yield from tap("RET", position)
        yield 0.1


def choose_other(position, owner, name: str):
    """The same for a drop-down at a position, which is of the property `owner`.`name`."""
    before = getattr(owner, name)
    for arrows in (1, 2):  # the first may be the one that it shows
        yield from drop_down(position, f"{owner.bl_rna.identifier}.{name}")
        for _ in range(arrows):
            yield from tap("DOWN_ARROW", position)
            yield 0.1
        yield from tap("RET", position)
        yield 0.1
        if getattr(owner, name) != before:
            setattr(owner, name, before)
            yield from drawn()
            return
    raise AssertionError(f"the arrow keys choose no other {name} than {before}")


def is_button(button: str, wanted: str) -> bool:
    """wanted: an operator, maybe with its arguments, or the end of a property's path."""
    call = wanted if "(" in wanted else f"{wanted}("
    return button.startswith(f"bpy.ops.{call}") or button.endswith(f".{wanted}")


def keep(name: str, region: Region, box=None):
    """A picture of a region, or of a box in it, for the guide."""
    if region.kind:
        yield from move(region.top)  # a list lets go of its highlighted row
    yield from rest()
    yield from drawn() if region.kind == "UI" else drawn_smoothly()
    photograph(name, box or region.box)
    result["pictures"].append(name)


# Steps ---------------------------------------------------------------------------------------------------------------

steps: list = []


def step(title: str, picture: Region | None = None):
    """Adds a generator function to the steps. `picture`: the guide shows this region after it, by the function's name.

    Every step leaves a picture of the whole window beside the result.
    """

    def add(function):
        steps.append((title, function, picture))
        return function

    return add


def _take_steps():
    own = [each for each in steps if each[1].__module__ == PART]  # without those of a part that it imports
    for number, (title, function, picture) in enumerate(own):
        name = function.__name__
        print(f"STEP {name}", flush=True)
        start, before = time.monotonic(), actions
        result["steps"].append({"title": title, "actions": 0, "seconds": 0.0})
        yield from function()
        result["steps"][-1] = {"title": title, "actions": actions - before, "seconds": time.monotonic() - start}
        yield from rest()
        yield from drawn()
        photograph(f"{PART}_{number:02}_{name}")
        if picture:
            yield from keep(name, picture)


def run():
    """Take the steps, write WORK/PART.json and, for the next part, WORK/PART.blend, and leave Blender."""
    preferences = bpy.context.preferences
    preferences.view.show_splash = False
    preferences.view.show_tooltips = False  # on a busy machine they get into pictures
    preferences.system.use_region_overlap = False  # pictures of panels, not of what lies behind them
    preferences.system.viewport_aa = "OFF"  # there is no graphics card
    walk = _take_steps()

    def tick():
        try:
            return next(walk)
        except StopIteration:
            with bpy.context.temp_override(window=window()):
                bpy.ops.wm.save_userpref()
                bpy.ops.wm.save_as_mainfile(filepath=str(WORK / f"{PART}.blend"), copy=True)
            result["ok"] = True
        except Exception:
            title = result["steps"][-1]["title"] if result["steps"] else "start"
            result["error"] = f"in step '{title}'\n{traceback.format_exc()}"
            photograph("failure")
        result["there"], result["opened"] = sorted(there), sorted(opened)
        (WORK / f"{PART}.json").write_text(json.dumps(result, indent=1))
        sys.stdout.flush()
        os._exit(not result["ok"])  # without questions about unsaved changes

    bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
