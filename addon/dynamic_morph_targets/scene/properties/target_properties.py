# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist authored about one target, stored on the Object."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict

import bpy
from bpy.types import PropertyGroup

from ...core.material import calibration, oscillation
from ...core.material.feel import FEELS
from ...core.settings import Material
from .. import keyed
from ..events import shown_changed
from ..keyless import ANIMATED, BoolProperty, FloatProperty, StringProperty
from ..references import OVERRIDE, KeyReference, key_displacement, key_hash
from ..skin import unit_scale
from .target_place import Placed

NEUTRAL = "Neutral"
MASS_DAMPING, STIFFNESS_DAMPING = FEELS["NATURAL"].damping.values()  # of a new soft skin
NEVER = 1e5  # seconds, for a swing that nothing damps


class DynamorphKey(KeyReference, PropertyGroup):
    """A shape key that a bake added or muted. A key of the bake that is gone leaves a reference without a name."""

    reach: FloatProperty(name="Reach", description="Largest displacement of a key that the bake added")
    was_muted: BoolProperty(name="Was Muted", description="Whether the artist had muted the key before the bake")

    def looks_like(self, block: bpy.types.ShapeKey) -> bool:
        return key_hash(block) == self.key_hash or math.isclose(key_displacement(block), self.reach, rel_tol=0.01)


def _get_bounce(target: DynamorphTarget) -> float:
    return oscillation.damped(target.omega, target.material()).frequency if target.is_measured else 0.0


def _set_bounce(target: DynamorphTarget, bounce: float) -> None:
    material = target.material()
    if target.is_measured:
        target.set_swing(*oscillation.with_bounce(target.omega, material, bounce))
    else:
        target.set_swing(oscillation.undamped(bounce, material), material)
    target.by_hand = True


def _get_settle_time(target: DynamorphTarget) -> float:
    if not target.is_measured:
        return 0.0
    return min(oscillation.damped(target.omega, target.material()).settle, NEVER)


def _set_settle_time(target: DynamorphTarget, seconds: float) -> None:
    if not target.is_measured:
        return
    material, bounce = target.material(), target.bounce
    if target.frequency and bounce:
        target.set_swing(*oscillation.with_swing(material, bounce, seconds))
    else:  # the artist has set the stiffness, or it only creeps
        target.mass_damping, target.stiffness_damping = oscillation.damping_for(target.omega, material, seconds)


def _get_mass(target: DynamorphTarget) -> float:
    return target.density * target.volume / _kilograms()


def _set_mass(target: DynamorphTarget, mass: float) -> None:
    if target.volume:
        target.density = mass * _kilograms() / target.volume


def _kilograms() -> float:
    """Kilograms per unit of a property with the unit MASS: Blender scales what it shows by the scene's unit scale."""
    return unit_scale() ** 3


_COMPUTED = ContextVar("computed", default=False)  # whether what is written now follows from something else


@contextmanager
def as_computed() -> Iterator[None]:
    """A stiffness written inside this context does not count as set by hand, and none follows a density."""
    token = _COMPUTED.set(True)
    try:
        yield
    finally:
        _COMPUTED.reset(token)


def _stiffness_set(target: DynamorphTarget, _context: bpy.types.Context) -> None:
    """update: the artist, or a script, wants the stiffness in pascals as it is."""
    if not _COMPUTED.get():
        target.frequency, target.by_hand = 0.0, True


def _density_set(target: DynamorphTarget, _context: bpy.types.Context) -> None:
    """update: a bounce that was set stays, and the stiffness follows."""
    if not _COMPUTED.get():
        target.follow_frequency()


def _region_chosen(target: DynamorphTarget, _context: bpy.types.Context) -> None:
    target.auto_region = False  # `regions.update` sets it again for those that it chooses itself


class DynamorphTarget(KeyReference, Placed, PropertyGroup):
    """A dynamic morph target: a shape key, the pose at which the skin takes it, and the elastic properties there.

    The first target of an object is the neutral one; its shape is the Basis.
    """

    mute: BoolProperty(name="Mute", description="Leave this target out of the model", override=OVERRIDE)
    stiffness: FloatProperty(
        name="Stiffness",
        description="Young's modulus at this target in pascals. Raise it to make the soft tissue firmer. Once it is "
        "set, it stays, and Bounce and Settle Time follow from it. Keys and drivers act at each step",
        default=Material.stiffness, min=1.0, max=1e12, soft_min=1e3, soft_max=1e6, step=10000, precision=0,
        options=ANIMATED, override=OVERRIDE, update=_stiffness_set,
    )  # fmt: skip
    poisson: FloatProperty(
        name="Poisson's Ratio",
        description="How well the soft tissue keeps its volume. 0 is not at all, near 0.5 is entirely. Values over "
        "0.4 make coarse cages too stiff. Lower it for foam",
        default=Material.poisson, min=0.0, max=0.49, soft_max=0.45, override=OVERRIDE,
    )  # fmt: skip
    density: FloatProperty(
        name="Density",
        description="Mass per volume at this target in kg/m³. Water has 1000. Where Stiffness was set, raise it for "
        "tissue that swings more slowly. Where Bounce was set, Bounce and Settle Time stay, and Stiffness follows",
        default=Material.density, min=1.0, max=1e5, soft_min=500.0, soft_max=2000.0, step=1000, precision=0,
        override=OVERRIDE, update=_density_set,
    )  # fmt: skip
    mass_damping: FloatProperty(
        name="Mass Damping",
        description="Rayleigh damping in proportion to mass, in 1/s. Raise it to calm slow, large motion. Stiffness "
        "stays, and Bounce and Settle Time follow",
        default=MASS_DAMPING, min=0.0, max=1e4, soft_max=20.0, override=OVERRIDE,
    )  # fmt: skip
    stiffness_damping: FloatProperty(
        name="Stiffness Damping",
        description="Rayleigh damping in proportion to stiffness, in seconds. Raise it to calm fast ripples. Stiffness "
        "stays, and Bounce and Settle Time follow",
        default=STIFFNESS_DAMPING, min=0.0, max=10.0, soft_max=0.1, step=0.1, precision=4, override=OVERRIDE,
    )  # fmt: skip
    amount: FloatProperty(
        name="Amount",
        description="How much of the motion is shown in this target's pose and region. Lower it for poses that should "
        "hold still; 0 shows only the sculpted shape",
        default=1.0, min=0.0, max=1.0, subtype="FACTOR", options=ANIMATED, override=OVERRIDE,
        update=shown_changed,
    )  # fmt: skip
    region: StringProperty(
        name="Region",
        description="Vertex group that the target is limited to. The targets of a region form a set with the neutral "
        "target: they do not compete with the targets of the rest of the body. Choose one for a target of one limb",
        override=OVERRIDE, update=_region_chosen,
    )  # fmt: skip
    auto_region: BoolProperty(
        name="Automatic Region",
        description="Whether the region is made from the sculpt, together with the targets that share a bone with "
        "this one. A region that you choose or paint stays as it is",
        override=OVERRIDE,
    )  # fmt: skip
    made_region: StringProperty(
        name="Region As Made", description="Hash of the automatic region's weights, to tell whether they were painted",
        options={"SKIP_SAVE"}, override=OVERRIDE,
    )  # fmt: skip
    frequency: FloatProperty(
        name="Frequency",
        description="Undamped natural frequency from which the stiffness of this target follows. 0 leaves the "
        "stiffness in pascals unchanged",
        default=0.0, min=0.0, max=1000.0, override=OVERRIDE,
    )  # fmt: skip
    by_hand: BoolProperty(
        name="Set by Hand",
        description="Whether the artist has set the bounce or the stiffness. No Feel then changes them",
        override=OVERRIDE,
    )  # fmt: skip
    # The artist's view, computed from the properties above and from what the last build measured.
    bounce: FloatProperty(
        name="Bounce",
        description="How fast the whole body would swing if it were as soft as this target. It sets the stiffness, and "
        "both dampings so that the settle time stays the same. Lower it for softer, slower motion. 0 is tissue that "
        "is damped too much to swing",
        min=0.05, max=1000.0, soft_min=0.5, soft_max=20.0, step=10, precision=2, subtype="FREQUENCY",
        options={"SKIP_SAVE"}, get=_get_bounce, set=_set_bounce,
    )  # fmt: skip
    settle_time: FloatProperty(
        name="Settle Time",
        description="Time until a twentieth of a swing is left, if the whole body were as soft as this target. It sets "
        "both dampings and keeps their proportion. Bounce stays, or Stiffness where that was set. Raise it for skin "
        "that wobbles longer",
        min=0.001, max=NEVER, soft_min=0.05, soft_max=5.0, step=10, precision=2, subtype="TIME_ABSOLUTE",
        options={"SKIP_SAVE"},
        get=_get_settle_time, set=_set_settle_time,
    )  # fmt: skip
    mass: FloatProperty(
        name="Mass",
        description="Mass of the soft tissue in the target's region, including tissue that the bones hold. It sets the "
        "density. Where Stiffness was set, heavier tissue bounces more slowly; where Bounce was set, that stays",
        min=1e-12, max=1e12, soft_max=100.0, step=10, precision=3, unit="MASS", options={"SKIP_SAVE"},
        get=_get_mass, set=_set_mass,
    )  # fmt: skip
    volume: FloatProperty(
        name="Volume", description="Volume of the soft tissue in the target's region in m³, measured by the last build",
        options={"SKIP_SAVE"},
    )  # fmt: skip

    @property
    def reference(self) -> float:
        """What the last build measured of the body: see `calibration.reference`. 0 if it did not."""
        skin = self.id_data.dynamorph
        model, poisson = skin.model, skin.targets[0].poisson
        return model.bounce_reference if math.isclose(poisson, model.poisson_reference, rel_tol=1e-5) else 0.0

    @property
    def omega(self) -> float:
        """The undamped angular frequency of the whole body if it were of this material, rad/s; 0 if not known."""
        return 2.0 * math.pi * (keyed.frequency_of(self) or self.reference * math.sqrt(self.stiffness / self.density))

    @property
    def is_measured(self) -> bool:
        """Whether it is known how this material swings. If not, bounce and settle time are 0."""
        return self.omega > 0.0

    def material(self) -> Material:
        return Material(keyed.stiffness_of(self), self.poisson, self.density, self.mass_damping, self.stiffness_damping)

    def set_material(self, material: Material, by_hand: bool = False) -> None:
        """Use this material with its stiffness as it is. by_hand: the artist has set it."""
        with as_computed():
            for name, value in asdict(material).items():
                setattr(self, name, value)
        self.frequency, self.by_hand = 0.0, by_hand

    def set_computed_stiffness(self, stiffness: float) -> None:
        """Young's modulus in pascals that follows from the frequency: it does not count as set by hand."""
        if stiffness != self.stiffness:
            with as_computed():
                self.stiffness = stiffness

    def set_swing(self, frequency: float, material: Material) -> None:
        """Swing at this undamped frequency (Hz) with the dampings of a material; the stiffness follows, once the body
        is measured.
        """
        self.mass_damping, self.stiffness_damping = material.mass_damping, material.stiffness_damping
        self.frequency = frequency
        self.follow_frequency()

    def follow_frequency(self) -> None:
        """Compute the stiffness from the frequency, if there is one and the body is measured."""
        if self.frequency and self.reference:
            self.set_computed_stiffness(calibration.stiffness_for(self.reference, self.density, self.frequency))

    def set_region(self, group: str, automatic: bool) -> None:
        """automatic: `regions.update` keeps the vertex group up to date."""
        if self.region != group:
            self.region = group
        self.auto_region = automatic
