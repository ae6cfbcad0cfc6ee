# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension in other languages: each file agrees with the sources, and messages come out with their values."""

import ast
import inspect
import string
import textwrap

import blf
import bpy
import pytest
from bl_ext.user_default.dynamic_morph_targets.core import errors, message
from bl_ext.user_default.dynamic_morph_targets.run import remembered
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.ui import base, languages, widgets
from bl_ext.user_default.dynamic_morph_targets.ui.operators import transfer
from bl_ext.user_default.dynamic_morph_targets.ui.panels import sections
from installed import PACKAGE
from layout import drawn

FILES = sorted((PACKAGE / "translations").glob("*.json"))
CODES = [path.stem for path in FILES]


def known(code: str) -> dict[str, str]:
    return languages.read(PACKAGE / "translations" / f"{code}.json")


def texts() -> set[str]:
    """All strings of the sources."""
    found = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(inspect.cleandoc(node.value))
    return found


def placeholders(text: str) -> list[tuple]:
    """Their names and formats."""
    return sorted((name, form, how) for _, name, form, how in string.Formatter().parse(text) if name is not None)


@pytest.fixture
def german(addon, monkeypatch):
    """Blender in German. The wheels come without languages, so Blender's functions are replaced there."""
    table = known("de")
    for module in (base, widgets, sections, transfer):
        for name in ("iface_", "rpt_"):
            monkeypatch.setattr(module, name, lambda text, *_context: table.get(text, text), raising=False)


def test_there_are_two(addon):
    assert {"de", "fr"} <= set(CODES)
    assert known("de").keys() == known("fr").keys()


@pytest.mark.parametrize("code", CODES)
def test_every_text_is_one_of_the_extension(addon, code):
    assert sorted(known(code).keys() - texts()) == []


@pytest.mark.parametrize("code", CODES)
def test_the_same_values_are_formatted_into_both(addon, code):
    assert [text for text, said in known(code).items() if placeholders(text) != placeholders(said)] == []


@pytest.mark.parametrize("code", CODES)
def test_they_follow_the_rules_of_the_interface(addon, code):
    """Nothing is empty or has spaces around it, and tooltips have no period at the end."""
    for text, said in known(code).items():
        assert said and said == said.strip() and "\n" not in said, text
        assert not (said.endswith(".") and len(said.split()) > 3), text


def test_errors_are_translated_with_their_names(soft_arm, german):
    """The name is not translated, whatever it is."""
    soft_arm.name = "Cage"
    with pytest.raises(RuntimeError, match="„Cage“ ist schon eine weiche Haut: „Backen“ drücken oder Ziele hinzufügen"):
        bpy.ops.dynamorph.add_soft_skin()


def test_panels_are_translated(soft_arm, stand_in, german):
    bpy.ops.dynamorph.bake()
    soft_arm.dynamorph.model.modes = 5
    assert "Veraltet: Detail (Moden) geändert" in " ".join(drawn(soft_arm))
    soft_arm.data.shape_keys.use_relative = False
    assert "„Arm“ verwendet absolute Formschlüssel" in " ".join(drawn(soft_arm))


def test_progress_is_translated(soft_arm, german, monkeypatch):
    job = Job(soft_arm, goal="BAKE")
    job.progress.fraction, job.progress.message = 0.38, message.Message("Simulating frame {frame}", frame=7)
    running = batch.Batch([job], "BAKE")
    running.time_left.seconds = 11.4
    monkeypatch.setattr(remembered.work, "running", running)
    assert "38%  noch 0:12  Einzelbild 7 wird simuliert" in drawn(soft_arm)


def test_a_message_is_its_english_text(addon):
    text = message.Message("'{name}' moves with '{body}'", name="{A}", body="B")
    assert text == "'{A}' moves with 'B'" and isinstance(text, str)
    nested = message.Message("Out of date: {reasons}", reasons=message.joined(", ", ["not built yet", text]))
    spanish = {"Out of date: {reasons}": "Caducado: {reasons}", "'{name}' moves with '{body}'": "{body} lleva {name}"}
    assert nested == "Out of date: not built yet, '{A}' moves with 'B'"
    assert message.translated(nested, lambda text: spanish.get(text, text)) == "Caducado: not built yet, B lleva {A}"


def test_errors_tell_their_sentence(addon):
    error = errors.SceneError("'{name}' is hidden", name="Arm")
    assert str(error) == "'Arm' is hidden"
    assert message.translated(errors.sentence(error), {"'{name}' is hidden": "{name}?"}.get) == "Arm?"
    assert errors.sentence(MemoryError()) == errors.NO_MEMORY
    assert errors.sentence(errors.SceneError("What has {braces} alone stays")) == "What has {braces} alone stays"


@pytest.mark.skipif(not bpy.app.build_options.international, reason="this Blender is built without languages")
@pytest.mark.parametrize("code, button", [("de_DE", "Modell aufbauen"), ("fr_FR", "Construire le modèle")])
def test_in_blender(soft_arm, code, button):
    view = bpy.context.preferences.view
    before, view.language = view.language, code
    try:
        assert bpy.app.translations.pgettext_iface("Build Model", "Operator") == button
        tip = bpy.ops.dynamorph.build.get_rna_type().description
        assert bpy.app.translations.pgettext_tip(tip) == known(code[:2])[tip]
        hold = soft_arm.dynamorph.model.bl_rna.properties["hold"]  # in Blender, Hold is to stop
        for text in (hold.name, *(item.name for item in hold.enum_items)):
            assert bpy.app.translations.pgettext_iface(text, hold.translation_context) == known(code[:2])[text]
        with pytest.raises(RuntimeError, match="„Arm“|«\u00a0Arm\u00a0»"):
            bpy.ops.dynamorph.add_soft_skin()
    finally:
        view.language = before


# Room ----------------------------------------------------------------------------------------------------------------

NARROW = 250  # pixels of a sidebar at a UI scale of 1
TAKEN = 70  # of those, beside a text: tabs, scroll bar, margins and icon


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize("code", ["", *CODES])
def test_messages_fit_a_narrow_sidebar(addon, code, scale):
    """As Blender's own font is wide."""
    wide = widgets.characters(NARROW * scale, scale)
    blf.size(0, 11.0 * scale)
    for text in known(code or "de").values() if code else known("de"):
        for line in textwrap.wrap(text, wide):
            assert blf.dimensions(0, line)[0] <= (NARROW - TAKEN) * scale, line


def test_a_wide_region_has_longer_lines(addon):
    characters = widgets.characters
    assert characters(280, 1.0) == characters(560, 2.0) < characters(500, 1.0)
    assert characters(10, 1.0) >= 16
