# SPDX-License-Identifier: GPL-3.0-or-later
"""How a soft skin feels: presets, Amount, and what the artist has set by hand."""

import json

import bpy
import numpy as np
import pytest
from bl_ext.user_default.dynamic_morph_targets.core.material import feel as material_feel
from bl_ext.user_default.dynamic_morph_targets.core.material import oscillation
from bl_ext.user_default.dynamic_morph_targets.run.bake import batch
from bl_ext.user_default.dynamic_morph_targets.run.bake.job import Job
from bl_ext.user_default.dynamic_morph_targets.scene.store import staleness
from builders import refused
from layout import drawn

pytest.importorskip("dynamorph", reason="needs the compiled engine: make build")

OPS = bpy.ops.dynamorph
FEELS = ("SUBTLE", "NATURAL", "CARTOON")


@pytest.fixture
def built_arm(soft_arm):
    """The soft arm with a coarse cage, so that it builds in a second."""
    soft_arm.dynamorph.model.cage_nodes, soft_arm.dynamorph.model.modes = 200, 8
    OPS.build()
    return soft_arm


def felt(target):
    """Frequency in Hz and damping ratio of a target that is measured."""
    material = target.material()
    seen = oscillation.damped(2 * np.pi * target.reference * np.sqrt(material.stiffness / material.density), material)
    return seen.frequency, seen.decay / np.hypot(2 * np.pi * seen.frequency, seen.decay)


# Presets -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", FEELS)
def test_a_preset_shows_without_a_build(built_arm, key):
    feel = material_feel.FEELS[key]
    built, content = built_arm.dynamorph.model.built, built_arm.dynamorph.model.content_id
    neutral, flexed = built_arm.dynamorph.targets
    flexed.set_computed_stiffness(3.0 * neutral.stiffness)
    assert OPS.apply_feel(feel=key) == {"FINISHED"}
    assert felt(neutral) == pytest.approx((feel.frequency, feel.damping_ratio), rel=1e-4)
    assert neutral.bounce == pytest.approx(feel.frequency, rel=1e-4)
    assert flexed.stiffness == pytest.approx(3.0 * neutral.stiffness)  # it keeps the ratio of the stiffnesses
    for target in (neutral, flexed):
        assert not target.by_hand
    assert flexed.frequency == pytest.approx(np.sqrt(3.0) * neutral.frequency)
    simulation = built_arm.dynamorph.simulation
    assert simulation.max_displacement == pytest.approx(feel.max_displacement)
    assert simulation.max_thickness == pytest.approx(feel.max_thickness)
    assert (built_arm.dynamorph.model.built, built_arm.dynamorph.model.content_id) == (built, content)
    assert staleness.model_age(built_arm) == []


def test_what_is_set_by_hand_stays_but_the_neutral(built_arm):
    neutral, flexed = built_arm.dynamorph.targets
    neutral.bounce = flexed.bounce = 9.0
    stiffness = flexed.stiffness
    OPS.apply_feel(feel="CARTOON")
    assert neutral.bounce == pytest.approx(2.5, rel=1e-4) and not neutral.by_hand
    assert flexed.stiffness == stiffness and flexed.by_hand and flexed.bounce == pytest.approx(9.0)


def test_before_a_build_the_frequency_waits(soft_arm):
    neutral, flexed = soft_arm.dynamorph.targets
    stiffness = neutral.stiffness
    OPS.apply_feel(feel="SUBTLE")
    subtle = material_feel.FEELS["SUBTLE"]
    assert neutral.bounce == pytest.approx(subtle.frequency) and neutral.stiffness == stiffness
    assert flexed.frequency == pytest.approx(neutral.frequency)
    assert neutral.mass_damping == 0.0
    OPS.build()
    assert felt(neutral) == pytest.approx((subtle.frequency, subtle.damping_ratio), rel=0.01)


def pressed(obj):
    return [text.removeprefix("pressed: ") for text in drawn(obj) if text.startswith("pressed: ")]


def test_the_preset_that_is_used_is_pressed(built_arm):
    assert pressed(built_arm) == []
    OPS.apply_feel(feel="NATURAL")
    assert pressed(built_arm) == ["Natural"]
    neutral, simulation = built_arm.dynamorph.targets[0], built_arm.dynamorph.simulation
    OPS.apply_feel(feel="CARTOON")
    assert pressed(built_arm) == ["Cartoon"]
    neutral.bounce = 4.0
    assert pressed(built_arm) == []
    OPS.apply_feel(feel="CARTOON")
    simulation.max_displacement = 0.04
    assert pressed(built_arm) == []


def test_a_new_soft_skin_feels_natural(arm):
    OPS.add_soft_skin()
    settings = arm.dynamorph
    assert material_feel.active(settings.targets[0], settings.simulation) == "NATURAL"
    assert settings.model.hold == "THICKNESS"
    assert settings.simulation.amount == 1.0
    assert pressed(arm) == ["Natural"]


# By hand -----------------------------------------------------------------------------------------------------------


def test_pascals_set_by_hand_count(built_arm):
    OPS.apply_feel(feel="NATURAL")
    target = built_arm.dynamorph.targets[1]
    target.set_computed_stiffness(3e4)
    assert target.frequency and not target.by_hand
    target.stiffness = 5e4
    assert target.frequency == 0.0 and target.by_hand
    OPS.build()
    assert target.stiffness == 5e4


@pytest.mark.parametrize("change", ["material", "fit"])
def test_a_material_is_set_by_hand(built_arm, change):
    OPS.apply_feel(feel="NATURAL")
    target = built_arm.dynamorph.targets[1]
    built_arm.dynamorph.active_target_index = 1
    if change == "material":
        OPS.apply_material(preset="FAT")
    else:
        OPS.fit_material(frequency=4.0, settle_time=0.75)
    assert target.frequency == 0.0 and target.by_hand


def test_bounce_keeps_the_settle_time(built_arm):
    target = built_arm.dynamorph.targets[0]
    for bounce in (1.0, 4.0, 15.0):
        settle = target.settle_time
        target.bounce = bounce
        assert target.bounce == pytest.approx(bounce, rel=1e-4) and target.settle_time == pytest.approx(
            settle, rel=1e-4
        )
        assert target.by_hand
    target.mass_damping = target.stiffness_damping = 0.0
    target.bounce = 3.0
    assert target.bounce == pytest.approx(3.0, rel=1e-4)
    assert (target.mass_damping, target.stiffness_damping) == (0.0, 0.0)


def test_setups_and_slots_keep_what_was_set_by_hand(built_arm, tmp_path):
    OPS.apply_feel(feel="NATURAL")
    neutral, flexed = built_arm.dynamorph.targets
    flexed.stiffness = 5e4
    OPS.save_setup(filepath=str(tmp_path / "arm.json"))
    OPS.copy_slot()
    known = [(t.stiffness, t.frequency, t.by_hand) for t in built_arm.dynamorph.targets]
    neutral.stiffness = 7e4
    OPS.apply_feel(feel="SUBTLE")
    flexed.bounce = 6.0
    OPS.swap_slot()
    assert [(t.stiffness, t.frequency, t.by_hand) for t in built_arm.dynamorph.targets] == known
    neutral.stiffness = 7e4
    OPS.load_setup(filepath=str(tmp_path / "arm.json"))
    assert [(t.stiffness, t.frequency, t.by_hand) for t in built_arm.dynamorph.targets] == known


# Amount ------------------------------------------------------------------------------------------------------------


def motion(obj, amount, **settings):
    """Displacements (F, V, 3) from the targets' shapes, of a bake that is not written."""
    obj.dynamorph.simulation.amount = amount
    job = Job(obj, "BAKE", stored=False, **settings)
    batch.run(job)
    return np.tensordot(job.outcome.bake.coordinates - job.outcome.bake.static, job.outcome.bake.modes, 1), job


def test_amount_scales_the_motion_of_a_bake(built_arm):
    whole, job = motion(built_arm, 1.0)
    assert np.abs(whole).max() > 1e-3
    half, _ = motion(built_arm, 0.5)
    none, _ = motion(built_arm, 0.0)
    np.testing.assert_allclose(half, 0.5 * whole, atol=1e-12)
    assert np.abs(none).max() < 1e-12
    np.testing.assert_array_equal(job.outcome.bake.static, motion(built_arm, 2.0)[1].outcome.bake.static)


def test_amount_is_out_of_date_in_a_bake_and_unknown_to_old_ones(built_arm):
    OPS.bake()
    record = built_arm.dynamorph.bake
    assert staleness.outdated(built_arm) == []
    built_arm.dynamorph.simulation.amount = 0.5
    assert staleness.outdated(built_arm) == ["Amount changed"]
    inputs = json.loads(record.inputs)
    del inputs["simulation"]["amount"]
    record.inputs = json.dumps(inputs)
    assert staleness.outdated(built_arm) == []


def test_buttons_need_a_soft_skin(arm):
    assert not OPS.apply_feel.poll() and not OPS.stiffen.poll()
    OPS.add_soft_skin()
    assert OPS.apply_feel.poll()
    refused(OPS.stiffen, "no verdict: press Bake first")
