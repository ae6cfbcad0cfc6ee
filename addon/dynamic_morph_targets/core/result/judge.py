# SPDX-License-Identifier: GPL-3.0-or-later
"""How believable a bake looks. No bpy.

Everything is measured in bind space, where a body that turns does not count as motion of its tissue, against the
targets' shapes. Lengths are relative to the body's size, the diagonal of its box at rest, or to its local thickness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache

import numpy as np

from .. import records
from ..character import Character
from ..engine import dynamorph
from ..geometry import determinant, diagonal, unique_edges, vertex_areas
from ..message import Message, named_frames
from ..model.model import Model
from ..motion.baked import Bake
from ..motion.contact import TooDeep, Touched
from ..motion.limits import THINNEST, Held
from ..settings import SimulationSettings

LOOKED_AT = 32  # at most so many frames, those that move most
CHECKED = 10  # of these, frames whose tetrahedra are checked
SHRUNK, STRETCHED = 0.6, 1.6  # of their length at rest; edges beyond that look torn
TURNED = 1e-3  # share of the skin that may be flipped, and of the volume that may be inverted
FOLDED = 0.3  # of their length at rest; edges that bones make shorter are not used to measure what motion adds
FLICKERS = 0.1  # of `flicker`; what turns more often flickers, a slow swing is near -1
HELD_BACK = 2.0  # of the largest excess of a load; below, the artist is not told
SHOWS = 1.05  # of the limits; a bake that exceeds them by more is not as requested
SPLINTER = 1e-4  # of the size; shorter edges are not used to measure stretch
SHOWN = 200  # vertices that mark the worst place


@dataclass(frozen=True)
class Limits:
    """How far the skin may move away from the animation, as fractions of the body's size and of its local thickness; 0:
    no limit.
    """

    displacement: float = 0.0
    thickness: float = 0.0


@dataclass(frozen=True)
class Verdict:
    """How believable a bake looks: what was measured, against which limits, and what that means to the artist.

    held: where the limits worked hardest. displacement: the largest, of the size; percentile: its 99.9th percentile in
    the worst frame; over_thickness: 99th percentile over the skin of each point's largest displacement over the
    thickness there; stretch: 0.1th and 99.9th percentile of edges' length over that at rest, in bind space and, where
    that is worse, over what the bones alone make of it; flipped: share of the skin turned over; inverted: share of the
    volume turned inside out; flicker: how often the motion turns, see `flicker_of`; frame: the worst; vertices: of the
    character's own mesh, at its worst place. touched: of a bake with Collision.
    """

    limits: Limits = Limits()
    held: Held = Held()  # noqa: RUF009
    displacement: float = 0.0
    percentile: float = 0.0
    over_thickness: float = 0.0
    stretch: tuple[float, float] = (1.0, 1.0)
    flipped: float = 0.0
    inverted: float = 0.0
    flicker: float = -1.0
    frame: float = 0.0
    vertices: tuple[int, ...] = ()
    touched: Touched | None = None

    @property
    def excess(self) -> float:
        """The factor by which the motion is too large. 0 without limits."""
        return max(self._exceeded.values(), default=0.0)

    @property
    def _exceeded(self) -> dict[str, float]:
        """The factors by which each limit is exceeded, by what the skin does then; none without limits."""
        limits = self.limits
        if not (limits.displacement or limits.thickness):
            return {}
        low, high = self.stretch
        # Where the bones alone shorten an edge, the motion may only add what SHRUNK leaves.
        found = {"is squeezed too far": (1.0 - low) / (1.0 - SHRUNK) / 0.9}
        found["is stretched too far"] = (high - 1.0) / (STRETCHED - 1.0)
        if limits.displacement:
            relative = max(self.percentile, self.displacement / 1.8) / limits.displacement
            found["moves farther than Max Displacement allows"] = relative
        if limits.thickness:
            found["moves farther than its thickness allows"] = self.over_thickness / limits.thickness
        turned = max(self.flipped, self.inverted) / TURNED
        if turned > 1.0:  # volumes decrease much faster than displacements
            found["is turned over"] = min(1.05 * turned**0.25, 1.5)
        return found

    @property
    def is_wreckage(self) -> bool:
        """Whether it looks broken whatever the limits are."""
        low, high = self.stretch
        return max(self.flipped, self.inverted) > TURNED or low < SHRUNK or high > STRETCHED

    @property
    def is_too_large(self) -> bool:
        """What a higher Bounce repairs."""
        return self.is_wreckage or self.excess > SHOWS

    @property
    def is_pressed(self) -> bool:
        """Whether something presses on the skin where it looks worst, which no stiffness helps."""
        runs = self.touched.pressed if self.touched else ()
        return any(first <= self.frame <= last for first, last in runs)

    @property
    def is_believable(self) -> bool:
        return not self.is_too_large and self.flicker <= FLICKERS

    @property
    def text(self) -> str:
        """One sentence for the artist, which names the worst fault."""
        if self.is_believable:
            return f"The skin moves believably, most at frame {self.frame:g}"
        low, high = self.stretch
        if self.inverted > TURNED:
            fault = "is pressed inside out"
        elif self.flipped > TURNED:
            fault = "is turned over"
        elif high > STRETCHED:
            fault = "is stretched too far"
        elif low < SHRUNK:
            fault = "is squeezed too far"
        elif self.is_too_large:
            exceeded = self._exceeded
            fault = max(exceeded, key=lambda name: exceeded[name])
        else:
            return "The skin flickers: it turns at every other frame, or more often"
        return f"The skin {fault} at frame {self.frame:g}"

    @property
    def held_back(self) -> Message | None:
        """Where bones move faster than their tissue can follow; None where they hardly do."""
        if self.held.excess < HELD_BACK:
            return None
        frames = named_frames(*self.held.frames)
        return Message(
            "'{bone}' moves {factor:.0f} times faster than its tissue can follow at {frames}: held back",
            bone=self.held.bone,
            factor=self.held.excess,
            frames=frames,
        )

    @property
    def contact_texts(self) -> list[Message]:
        """What went wrong where the skin met colliders."""
        return self.touched.texts if self.touched else []

    @property
    def factor(self) -> float:
        """On Bounce, to repair it."""
        return max(1.15, self.excess**0.75) if self.is_too_large else 1.0

    @property
    def figures(self) -> dict[str, str]:
        """What was measured, by name, as the panel shows it."""
        low, high = self.stretch
        figures = {
            "Displacement": f"{self.displacement:.1%} of size",
            "Of Thickness": f"{self.over_thickness:.2f}",
            "Inverted Volume": f"{self.inverted:.2%}",
            "Flipped Skin": f"{self.flipped:.2%}",
            "Stretch": f"{low:.2f} to {high:.2f}",
            "Flicker": f"{(1.0 + self.flicker) / 2.0:.0%}",  # 0 % a slow swing, 100 % up and down at every other frame
        }
        if self.limits != Limits():
            figures["Largest Load"] = f"{self.held.excess:.1f} of limit"
            figures["Between Frames"] = f"{self.held.reached:.0%} of limit"
        if self.touched:
            figures["Penetration"] = f"{1000.0 * self.touched.penetration:.2g} mm"
        return figures

    @property
    def record(self) -> str:
        """The verdict as it is stored with the bake, for `parsed`."""
        return records.text(asdict(self))


@lru_cache(maxsize=16)
def parsed(record: str) -> Verdict | None:
    """The verdict that `Verdict.record` stored; None without a record. Raises RecordError."""
    if not record:
        return None
    values = records.verdict(record)
    touched = values.get("touched")
    if touched:
        left_inside = tuple(TooDeep(*each) for each in touched["left_inside"])
        others = (tuple(map(tuple, touched[name])) for name in ("unusable", "pressed"))
        values["touched"] = Touched(touched["penetration"], left_inside, *others)
    lists = {name: tuple(values[name]) for name in ("stretch", "vertices")}
    held = Held(**values["held"] | {"frames": tuple(values["held"]["frames"])})
    return Verdict(**values | lists | {"limits": Limits(**values["limits"]), "held": held})


def judge(
    model: Model,
    character: Character,
    bake: Bake,
    settings: SimulationSettings,
    held: Held,
    touched: Touched | None = None,
    poses: np.ndarray | None = None,
) -> Verdict:
    """The verdict on a bake of `character` with `model` and these settings. It covers all the character's vertices.
    poses (F, B + 1, 3, 4): the bones at its frames, bind to world space, where they are known.
    """
    limits = Limits(settings.max_displacement, settings.max_thickness)
    triangles = character.soft_triangles
    if not len(bake.modes) or not len(triangles):
        return Verdict(limits, held, frame=float(bake.frames[0]), touched=touched)
    skin = _Skin(character, triangles, model.thickness)
    motion = bake.coordinates - bake.static
    modes = (bake.modes @ character.to_bind.T).reshape(len(bake.modes), -1)
    displacement = np.linalg.norm(motion * np.linalg.norm(modes, axis=1), axis=1)
    chosen = np.sort(np.argsort(-displacement)[:LOOKED_AT])
    found = skin.deformation(motion[chosen], modes)
    largest, flipped = found.largest.max(), found.flipped.max()
    worst = int(chosen[(found.largest / max(largest, 1e-300) + found.flipped / max(flipped, TURNED)).argmax()])
    u = (motion[worst] @ modes).reshape(-1, 3)
    stretch = float(found.shortest.min()), float(found.longest.max())
    if poses is not None and len(poses) == len(motion) and touched is None:  # a press squeezes where it presses
        liveliest = chosen[np.argsort(-displacement[chosen])[:CHECKED]]
        posed = [skin.posed_stretch(character, bake, frame, poses[frame], motion, modes) for frame in liveliest]
        stretch = min(stretch[0], *(low for low, _ in posed)), max(stretch[1], *(high for _, high in posed))
    return Verdict(
        limits,
        held,
        displacement=float(largest) / skin.size,
        percentile=float(found.percentile.max()) / skin.size,
        over_thickness=skin.over_thickness(found.farthest),
        stretch=stretch,
        flipped=float(flipped),
        flicker=_flicker(motion[:: settings.samples], modes, skin.areas),
        inverted=_inverted(model, bake, chosen[np.argsort(-displacement[chosen])[:CHECKED]]),
        frame=float(bake.frames[worst]),
        vertices=tuple(vertex for vertex in skin.place(u) if vertex < character.own_vertices.stop),
        touched=touched,
    )


class _Skin:
    """The soft part (T, 3) of a character's surface, bind space. thickness (V,): radii, meters, or none."""

    def __init__(self, character: Character, triangles: np.ndarray, thickness: np.ndarray):
        self.rest = rest = character.bind_points
        self.triangles = triangles
        self.areas = vertex_areas(rest, triangles)
        self.size = diagonal(rest)
        edges = unique_edges(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), len(rest))
        edges = edges[np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1) > SPLINTER * self.size]
        begins = [0, *(each.members.start for each in character.attachments)]
        mesh = np.searchsorted(begins, edges[:, 0], side="right")
        self.edges = [edges[mesh == number] for number in np.unique(mesh)]
        self.thickness = 2.0 * thickness if len(thickness) else np.zeros(0)

    def deformation(self, motion: np.ndarray, modes: np.ndarray) -> dynamorph.Deformation:
        """What displacements by motion (F, r) of modes (r, 3V) do to it, in meters."""
        shapes = modes.reshape(len(modes), -1, 3)
        return dynamorph.measure_deformation(self.rest, self.triangles, self.edges, motion, shapes)

    def posed_stretch(
        self, character: Character, bake: Bake, frame: int, bones: np.ndarray, motion: np.ndarray, modes: np.ndarray
    ) -> tuple[float, float]:
        """The 0.1th and 99.9th percentile of edges' length over what the bones and the targets' shapes alone make of it
        at a frame: what bones have folded already is squeezed sooner.
        """
        shape = self.rest + (bake.static[frame] @ modes).reshape(-1, 3)
        shape += np.tensordot(bake.weights[frame], bake.residual_shapes, 1) @ character.to_bind.T
        moves = np.tensordot(character.weights, bones, 1)  # (V, 3, 4)
        alone = np.einsum("vij,vj->vi", moves[:, :, :3], shape) + moves[:, :, 3]
        moved = alone + np.einsum("vij,vj->vi", moves[:, :, :3], (motion[frame] @ modes).reshape(-1, 3))
        low, high = [1.0], [1.0]
        for edges in self.edges:
            rest, folded, now = (
                np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
                for points in (self.rest, alone, moved)
            )
            told = folded > FOLDED * rest
            if told.any():
                found = np.quantile(now[told] / folded[told], [0.001, 0.999])
                low.append(float(found[0]))
                high.append(float(found[1]))
        return min(low), max(high)

    def over_thickness(self, farthest: np.ndarray) -> float:
        """The 99th percentile of displacement over thickness; farthest (V,): largest displacements, meters."""
        if not len(self.thickness):
            return 0.0
        used = self.areas > 0.0
        over = farthest / np.maximum(self.thickness, THINNEST * self.size)
        return quantiles(over[used], self.areas[used], [0.99])[0]

    def place(self, u: np.ndarray) -> tuple[int, ...]:
        """The vertices that move most and are near the one that moves most of all."""
        distance = np.where(self.areas > 0.0, np.linalg.norm(u, axis=1), 0.0)
        order = np.argsort(-distance)[:SHOWN]
        near = np.linalg.norm(self.rest[order] - self.rest[order[0]], axis=1) < 0.1 * self.size
        return tuple(order[near].tolist())


def _inverted(model: Model, bake: Bake, frames: np.ndarray) -> float:
    """The largest share of the filled volume that the motion, and not the sculpt, turns inside out."""
    if bake.node_modes is None or not len(model.tets):
        return 0.0
    corners = model.nodes[model.tets]
    rest = determinant(corners[:, 1:] - corners[:, :1])
    filled, worst = model.fill * rest, 0.0
    for frame in frames:
        moved, sculpted = (
            determinant(at[:, 1:] - at[:, :1])
            for at in (
                corners + np.tensordot(coordinates, bake.node_modes, 1)[model.tets]
                for coordinates in (bake.coordinates[frame], bake.static[frame])
            )
        )
        worst = max(worst, float(filled[(moved <= 0.0) & (sculpted > 0.0)].sum() / filled.sum()))
    return worst


def _flicker(motion: np.ndarray, modes: np.ndarray, areas: np.ndarray) -> float:
    """Of the skin, by its areas (V,). motion (F, r): coordinates about the targets' shapes; modes (r, 3V)."""
    products = (modes * np.repeat(areas, 3)) @ modes.T
    change = np.diff(motion, axis=0)
    return flicker_of(change, change @ products)


def flicker_of(change: np.ndarray, weighted: np.ndarray) -> float:
    """How often a motion turns: minus the correlation of its change from one frame with that to the next. A slow swing
    is near -1, a swing of a quarter of the frame rate 0, up and down at every other frame 1; -1, too, where nothing
    moves.

    change (F, n): from each frame to the next; weighted (F, n): the same times the metric in which it is compared.
    """
    squares = (change * weighted).sum()
    if len(change) < 2 or squares <= 0.0:
        return -1.0
    turns = (change[1:] * weighted[:-1]).sum()
    return float(-turns / (squares * (len(change) - 1) / len(change)))


def quantiles(values: np.ndarray, weights: np.ndarray, shares: Sequence[float]) -> list[float]:
    """The values (n,) below which these shares of the weights (n,) are."""
    return [_quantile(values, weights, share, weights.sum()) for share in shares]


def _quantile(values: np.ndarray, weights: np.ndarray, share: float, whole: float) -> float:
    """Looks among a few values at that end first, because all of them take long to sort."""
    few = max(len(values) // 50, 1)
    low = share < 0.5
    end = np.argpartition(values, few - 1)[:few] if low else np.argpartition(values, -few)[-few:]
    before = 0.0 if low else whole - weights[end].sum()
    if not 0.0 < share * whole - before <= weights[end].sum():
        end, before = np.arange(len(values)), 0.0
    order = end[np.argsort(values[end])]
    at = int(np.searchsorted(before + np.cumsum(weights[order]), share * whole))
    return float(values[order[min(at, len(order) - 1)]])
