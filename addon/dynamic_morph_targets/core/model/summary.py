# SPDX-License-Identifier: GPL-3.0-or-later
"""What a build reports about a model, stored with it. No bpy."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Summary:
    """Facts about a model for reports. What was not built, or does not apply, has its default.

    nodes, tets: of the cage. pinned: number of its nodes that bones move; held: mean of the hold, or fraction of the
    nodes that are pinned; held_parts: number of loose parts that are pinned. defects: of the skin; quality: of the
    tetrahedra; glued: what was found, and cut, where skin merely touches. dofs, modes: of what is simulated;
    tabulated: number of the modes with energy tables; targets: `Character.target_count`. fitted: first and last frame
    of the shot to which the modes were fitted. seconds: of the build by stage; they are not stored.
    """

    nodes: int = 0
    tets: int = 0
    pinned: int = 0
    held: float = 0.0
    held_parts: int = 0
    defects: dict[str, int] = field(default_factory=dict)
    quality: dict[str, float] = field(default_factory=dict)
    glued: dict[str, int] = field(default_factory=dict)
    dofs: int = 0
    modes: int = 0
    tabulated: int = 0
    targets: int = 0
    fitted: tuple[int, int] | None = None
    warnings: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def stored(self) -> dict:
        """As JSON data, for `from_stored`. The same model gives the same: the build times are left out."""
        return {name: value for name, value in vars(self).items() if name != "seconds"}

    @classmethod
    def from_stored(cls, stored: dict) -> Summary:
        """The inverse of `stored`, once `schema.check` has found it sound."""
        fitted = tuple(stored["fitted"]) if stored["fitted"] else None
        return cls(**stored | {"fitted": fitted, "warnings": tuple(stored["warnings"])})
