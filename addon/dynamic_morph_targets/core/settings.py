# SPDX-License-Identifier: GPL-3.0-or-later
"""The settings of models, simulations and outputs as plain data. Never touches bpy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Material:
    """Elastic properties at one target, SI: stiffness is Young's modulus in Pa, damping is Rayleigh's."""

    stiffness: float = 2.0e4
    poisson: float = 0.4
    density: float = 1000.0
    mass_damping: float = 1.0  # alpha, 1/s
    stiffness_damping: float = 0.005  # beta, s

    def lame(self) -> tuple[float, float]:
        """Lame's lambda and mu, Pa."""
        e, nu = self.stiffness, self.poisson
        return e * nu / ((1 + nu) * (1 - 2 * nu)), e / (2 * (1 + nu))


# What targets do to the soft tissue: the same names in the interface and on the command line.
METHODS = {
    "DYNAMIC": ("Dynamic", "Shape, stiffness, damping and density follow the pose"),
    "SHAPE": ("Shape", "The rest shape follows the pose, and the material is the neutral target's everywhere"),
    "SINGLE": ("Single", "Only the neutral target counts, as in an ordinary soft body"),
    "STATIC": ("Static", "The shape follows the pose as geometric morph targets do, and nothing moves by itself"),
}
# The variants that `dynamorph report` compares, as changes of ModelSettings. All other settings are the object's own.
VARIANTS: dict[str, dict[str, str]] = {
    "static morphs": {"method": "STATIC"},
    "pose-dependent shape": {"method": "SHAPE"},
    **{
        f"{material} {material_model} {solver}": {
            "method": method,
            "material_model": material_model.replace(" ", "_").upper(),
            "solver": solver.upper(),
        }
        for material_model in ("linear", "StVK", "stable StVK")
        for solver in ("full", "reduced")
        for material, method in (("single", "SINGLE"), ("DMT", "DYNAMIC"))
    },
}
# Settings on which a built model does not depend, because they are applied when it is simulated.
FREE_SETTINGS = {"blending"}
ENGINE = 1  # version of the computation; raised when the same scene gives a different model or motion than before
TABULATED = 8, 30  # fewest and most modes with energy tables beside responses
REHEARSED = 40, 60  # fewest and most modes of a large model's rehearsal; tables grow as r^4
MOST_SUBSTEPS = 1000  # per frame


@dataclass(frozen=True)
class ModelSettings:
    """Everything that a built model depends on, apart from the character itself. method: see METHODS.

    The defaults are those of a new soft skin.
    """

    method: str = "DYNAMIC"
    material_model: str = "STABLE_STVK"
    solver: str = "REDUCED"
    blending: str = "EVEN"
    modes: int = 120
    fit_to_shot: bool = False  # choose the MODES of `basis` from the motion of the shot
    cage_nodes: int = 2000
    pin_radius: float = 0.4  # fraction of the way from a bone to the skin within which the bone holds nodes
    hold: str = "THICKNESS"  # what holds the body: its thickness, by a continuous energy, or pins near the BONES
    hold_head: bool = True  # the skin of head, hands and feet is held as if it were rigid
    basis: str = "RESPONSES"  # of a reduced model: tabulated MODES, or few of them and many linear RESPONSES

    @property
    def fits_shot(self) -> bool:
        """Whether the modes are chosen from the motion of a shot. Responses are not: they are so many that few modes
        fitted to a shot, which are all tabulated, are not as accurate.
        """
        return self.fit_to_shot and self.basis == "MODES" and self.solver == "REDUCED" and self.method != "STATIC"

    @property
    def rehearsed_modes(self) -> int:
        """How many modes a large model is built with at most: to be fitted to a shot it is rehearsed with more."""
        fewest, limit = REHEARSED
        return max(self.modes, min(max(2 * self.modes, fewest), limit)) if self.fits_shot else self.modes

    @property
    def tabulated(self) -> int:
        """How many of `modes` have energy tables. Their cost grows with the fourth power of their number, that of
        responses linearly.
        """
        if self.basis == "MODES":
            return self.modes
        fewest, limit = TABULATED
        return min(max(self.modes // 6, fewest), limit, self.modes)


@dataclass(frozen=True)
class SimulationSettings:
    """One run: frames frame_start..frame_end at `fps`, each in `substeps` steps; gravity (3,) world, m/s^2.

    speed: seconds that are simulated in a second of the shot; less than 1 is slow motion. samples: states per frame
    that are kept; `substeps` is a multiple of it. initial_state: REST_SHAPE has the targets' shapes without motion
    at the first frame, SETTLED is in balance and moves with the rig. run_up: frames that are simulated before
    `frame_start` and dropped; a cycle needs none. loop: the range is a cycle. gains: factors on the modes' motion
    about the targets' shapes, 1 for further modes; amount: on all of it. max_displacement, max_thickness: how far
    the skin may move away from its targets' shapes, as fractions of the body's size and of its thickness there; 0
    for no limit. collision: whether colliders stop the skin; distance: how far from them, as a fraction of the
    body's size. self_collision: whether the body does, too; self_friction: of its skin on itself.
    """

    frame_start: int = 1
    frame_end: int = 250
    fps: float = 24.0
    substeps: int = 5
    integrator: str = "BDF2"
    gravity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    samples: int = 1
    run_up: int = 0
    initial_state: str = "SETTLED"
    loop: bool = False
    gains: tuple[float, ...] = ()
    amount: float = 1.0
    max_displacement: float = 0.0
    max_thickness: float = 0.0
    collision: bool = False
    distance: float = 0.002
    self_collision: bool = False
    self_friction: float = 0.0
    speed: float = 1.0

    def __post_init__(self) -> None:
        if self.substeps % self.samples:
            raise ValueError(f"substeps: expected a multiple of samples ({self.samples}), got {self.substeps}")

    @property
    def frames(self) -> np.ndarray:
        """The frames of the result, with fractions for the samples between them."""
        return self.times[self.run_up * self.samples :]

    @property
    def first(self) -> int:
        """The frame that the simulation begins with."""
        return self.frame_start - self.run_up

    @property
    def simulated(self) -> np.ndarray:
        """The whole frames, including those that are dropped."""
        return np.arange(self.first, self.frame_end + 1)

    @property
    def times(self) -> np.ndarray:
        """The times of all states, like `frames`, including those that are dropped."""
        if self.samples == 1:
            return self.simulated
        return self.first + np.arange((self.frame_end - self.first) * self.samples + 1) / self.samples

    def reached(self, states: int) -> int:
        """The frame that is finished after so many states; without any, the first."""
        return self.first + max(states - 1, 0) // self.samples

    @property
    def rate(self) -> float:
        """Frames per simulated second."""
        return self.fps / self.speed

    @property
    def step(self) -> float:
        """The time step in simulated seconds."""
        return 1.0 / (self.rate * self.substeps)


@dataclass(frozen=True)
class OutputSettings:
    """The form of a bake in Blender. format: MODES or PC2."""

    format: str = "MODES"
    keys: int = 0  # largest number of keys for MODES; 0: no limit
