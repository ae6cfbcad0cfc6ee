# SPDX-License-Identifier: GPL-3.0-or-later
"""What a character is read from: a mesh object and its rig. Each question is asked of Blender once."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import bpy
import numpy as np

from ...core.character import Skeleton
from ...core.geometry import inverse
from ..references import rest_skeleton
from ..skin import attached_meshes
from ..skinning import Skinning
from .identity import body_points
from .mesh_data import VertexGroups, bone_segments, carried, mesh_triangles, modifier_weights, stretch
from .worlds import worlds_at_start

Sources: TypeAlias = "dict[tuple[int, int, int], Source]"  # by mesh, rig and body
_READ: ContextVar[Sources | None] = ContextVar("read", default=None)  # within `read_once`


@contextmanager
def read_once() -> Iterator[None]:
    """Each mesh is read once within, whoever asks, until `read_again` says that some may have other vertex groups."""
    token = _READ.set({})
    try:
        yield
    finally:
        _READ.reset(token)


def read_again() -> None:
    """Forget those whose vertex groups have changed, and which meshes belong to others."""
    read = _READ.get() or {}
    for key, source in [*read.items()]:
        vars(source).pop("meshes", None)
        if source.groups.names != source.obj.vertex_groups.keys():
            del read[key]


@dataclass(frozen=True, eq=False)
class Source:
    """A mesh object that becomes a character, or a part of one. It lives as long as one reading, as `Skinning` does.

    rig: the armature object that moves the character, None without one. body: of an attachment, the source of the soft
    skin's own mesh. Properties that read the mesh or evaluate the scene raise SceneError.
    """

    skinning: Skinning
    rig: Any
    body: Source | None = None

    @classmethod
    def of(cls, skinning: Skinning, rig: Any = None) -> Source:
        """The source of a soft skin's own mesh, which an armature skins: by default its own."""
        return cls(skinning, rig or skinning.rig)._shared()

    def attachment(self, skinning: Skinning) -> Source:
        """The source of another mesh that this one carries along."""
        return Source(skinning, self.rig, self)._shared()

    def _shared(self) -> Source:
        """Itself, or within `read_once` the first one of the same mesh."""
        read = _READ.get()
        if read is None or self.rig is None:
            return self
        body = self.body.obj.session_uid if self.body else 0
        return read.setdefault((self.obj.session_uid, self.rig.session_uid, body), self)

    @property
    def obj(self) -> bpy.types.Object:
        return self.skinning.obj

    @cached_property
    def skeleton(self) -> Skeleton:
        """The bones of the rig at rest."""
        return self.body.skeleton if self.body else rest_skeleton(self.rig.data)

    @cached_property
    def groups(self) -> VertexGroups:
        return VertexGroups(self.obj)

    @cached_property
    def points(self) -> np.ndarray:
        """`body_points`."""
        return body_points(self.obj, self.groups)

    @cached_property
    def triangles(self) -> np.ndarray:
        return mesh_triangles(self.obj.data)

    @cached_property
    def weights(self) -> np.ndarray:
        """Skin weights (V, B + 1), like `Character.weights`."""
        modifier = self.skinning.modifier_of(self.rig)
        return modifier_weights(self.obj, modifier, self.skeleton, self.groups)

    @cached_property
    def left_behind(self) -> np.ndarray:
        """Which vertices (V,) no bone moves."""
        unmoved = self.weights[:, -1] >= 1.0
        for modifier in self.skinning.modifiers:
            if modifier != self.skinning.modifier:
                skeleton = rest_skeleton(modifier.object.data)
                unmoved &= modifier_weights(self.obj, modifier, skeleton, self.groups)[:, -1] >= 1.0
        return unmoved

    @cached_property
    def _worlds(self) -> list[np.ndarray]:
        return worlds_at_start(self.obj, self.rig)

    @property
    def world(self) -> np.ndarray:
        """The mesh object's transform (4, 4) when the scene starts, meters."""
        return self._worlds[0]

    @property
    def rig_world(self) -> np.ndarray:
        """The armature's transform (4, 4) then."""
        return self._worlds[1]

    @cached_property
    def to_bind(self) -> np.ndarray:
        """Local to bind space (3, 3)."""
        return stretch(self.world)

    def bone_segments(self, bones: Iterable[bpy.types.Bone]) -> np.ndarray:
        """Heads and tails (D, 2, 3) of bones of the rig at rest, bind space."""
        return bone_segments(bones, inverse(self.world) @ self.rig_world, self.to_bind)

    @cached_property
    def bone_heads(self) -> np.ndarray:
        """Heads (B, 3) of the skeleton's bones at rest, bind space."""
        bones = self.rig.data.bones
        return self.bone_segments([bones[name] for name in self.skeleton.names])[:, 0]

    @cached_property
    def meshes(self) -> list[Source]:
        """The other meshes in the cage of a soft skin."""
        return [self.attachment(Skinning.of(each)) for each in attached_meshes(self.obj)]

    # An attachment ---------------------------------------------------------------------------------------------------

    @cached_property
    def to_body(self) -> np.ndarray:
        """The attachment's local space to the body's (4, 4)."""
        assert self.body is not None
        return inverse(self.body.world) @ self.world

    @cached_property
    def in_body(self) -> np.ndarray:
        """The points (V, 3) in the body's local space."""
        return self.points if self.body is None else carried(self.points, self.to_body)
