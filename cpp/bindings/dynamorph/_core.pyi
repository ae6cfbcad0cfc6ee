"""
Dynamorph engine: soft skins from dynamic morph targets.
"""
from __future__ import annotations
import collections.abc
import numpy
import numpy.typing
import scipy.sparse
import typing
import typing_extensions
__all__: list[str] = ['Basis', 'Blending', 'Cancelled', 'Crowd', 'Embedding', 'Error', 'FullModel', 'FullSimulation', 'Kernel', 'Law', 'MeshCut', 'MorphTarget', 'PoseSpace', 'ReducedModel', 'ReducedSimulation', 'ReducedTables', 'Scheme', 'SoftBody', 'TargetSet', 'TetMesh', 'Thickness', 'closed_surface', 'embed', 'extend_to_nodes', 'fill_fractions', 'instruction_set', 'make_basis', 'make_cage', 'pinned', 'points_on_bones', 'reduce', 'set_threads', 'tetrahedralize', 'unpack_model']
class Error(RuntimeError):
    pass
class Cancelled(RuntimeError):
    pass
class TetMesh:
    """
    Tetrahedra: n nodes, m tets.
    """
    def __init__(self, nodes: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tets: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> None:
        """
        A mesh from stored arrays.
        
        nodes (n, 3): rest positions, metres. tets (m, 4): node indices. Raises ValueError on an index out of range, a NaN, a
        tet that is flat or inside out, or a node of no tet.
        """
    @property
    def nodes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Rest positions (n, 3), metres.
        """
    @property
    def tets(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 4]"]:
        """
        Node indices (m, 4), positively oriented.
        """
    @property
    def volumes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Volumes (m,), cubic metres.
        """
class Embedding:
    """
    Where V surface points sit in a TetMesh.
    """
    def __init__(self, nodes: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 4]"]) -> None:
        """
        One that was kept: nodes, weights (V, 4); its distances are not known.
        """
    def interpolate(self, values: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Values (V, k) at the points from values (n, k) at the nodes.
        """
    @property
    def distances(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Distance (V,) to the mesh, metres: 0 inside.
        """
    @property
    def nodes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 4]"]:
        """
        The nodes (V, 4) that carry each point: those of one tet.
        """
    @property
    def weights(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 4]"]:
        """
        Their weights (V, 4): rows sum to 1; negative only outside.
        """
class MeshCut:
    """
    Tetrahedra that join skin far apart, as of an arm and the side it hangs at.
    
    Two that share a face are glued when the way through the flesh between their skins is longer than 3 times the straight
    distance, and than 4 times their longest edge. Loose parts of the skin, which no way joins, are not.
    """
    def __init__(self, mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> None:
        """
        Finds the glued tetrahedra.
        
        vertices (V, 3): metres. triangles (T, 3): the outward skin in the mesh, open or not. Raises ValueError on wrong shapes
        or indices.
        """
    def cut(self) -> TetMesh:
        """
        The TetMesh with a crack between glued tetrahedra.
        
        The same tetrahedra; the nodes along the crack are doubled, the doubles at the end.
        """
    def embed(self, cut: TetMesh) -> Embedding:
        """
        The Embedding of the V vertices in the mesh as cut, each in a tetrahedron that belongs to skin near it.
        """
    @property
    def glued(self) -> numpy.typing.NDArray[numpy.bool]:
        """
        Which tetrahedra are glued, bool (m,).
        """
class Thickness:
    """
    How thick a body is: the radius of the largest ball in it that covers a point.
    
    Wide in a belly, narrow in a finger; continuous. Skin that lies inside other skin does not count.
    """
    def __init__(self, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], progress: typing.Any = None) -> None:
        """
        Of any triangle soup, which is closed first.
        
        vertices (V, 3): metres. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Raises Error as
        `closed_surface`.
        """
    def at(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        (thickness (k,), depth (k,)) at points (k, 3); metres.
        
        Depth is the distance to the skin, 0 outside of the body; a point there has the thickness of the skin nearest to it.
        """
class Kernel:
    """
    Members:
    
      LINEAR
    
      GAUSSIAN
    
      THIN_PLATE
    """
    GAUSSIAN: typing.ClassVar[Kernel]
    LINEAR: typing.ClassVar[Kernel]
    THIN_PLATE: typing.ClassVar[Kernel]
    __members__: typing.ClassVar[dict[str, Kernel]]
    @typing.overload
    def __eq__(self, other: Kernel) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Kernel) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class TargetSet:
    """
    Targets whose weights sum to one.
    """
    def __init__(self, bones: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], names: collections.abc.Sequence[str], poses: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64]], kernel: Kernel = Kernel.LINEAR, radii: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = []) -> None:
        """
        bones: indices whose local rotations place the targets; poses: per target the local transforms (B, 4, 4) of the whole skeleton; radii: per target the joint angle, radians, at which it has faded out, 0 for never, which all are by default. What has faded goes to the first target, whose own radius is ignored.
        """
class PoseSpace:
    """
    Interpolates target weights over pose space.
    """
    def __init__(self, sets: collections.abc.Sequence[TargetSet]) -> None:
        """
        Raises Error, naming both, when two targets of a set have the same pose.
        """
    def distances(self, local: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Distances (S, J) in radians of the local transforms (S, B, 4, 4) to each target's pose: the root of the summed squares of the joint angles that its set names.
        """
    def weights(self, local: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Weights (S, J) at the local transforms (S, B, 4, 4): each set's are >= 0, sum to 1, and are one at a target's own pose.
        """
    @property
    def targets(self) -> int:
        ...
class Law:
    """
    Members:
    
      LINEAR
    
      STVK
    
      STABLE_STVK
    """
    LINEAR: typing.ClassVar[Law]
    STABLE_STVK: typing.ClassVar[Law]
    STVK: typing.ClassVar[Law]
    __members__: typing.ClassVar[dict[str, Law]]
    @typing.overload
    def __eq__(self, other: Law) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Law) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class Blending:
    """
    Members:
    
      FORCES
    
      EVEN
    """
    EVEN: typing.ClassVar[Blending]
    FORCES: typing.ClassVar[Blending]
    __members__: typing.ClassVar[dict[str, Blending]]
    @typing.overload
    def __eq__(self, other: Blending) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Blending) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class MorphTarget:
    """
    A dynamic morph target: shape and elastic properties.
    """
    def __init__(self, name: str, displacement: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], *, lame_lambda: typing.SupportsFloat | typing.SupportsIndex, lame_mu: typing.SupportsFloat | typing.SupportsIndex, density: typing.SupportsFloat | typing.SupportsIndex, mass_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, stiffness_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, set: typing.SupportsInt | typing.SupportsIndex = 0, shifted: bool = False) -> None:
        """
        displacement (n, 3) metres, bind space, zero at pinned nodes; Lame's parameters in Pa, density kg/m^3, Rayleigh damping in 1/s and s; set: index of its target set; shifted: elastic as the neutral shape, moved by the displacement.
        """
class SoftBody:
    """
    What all models of one character share.
    """
    def __init__(self, mesh: TetMesh, fill: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], region_weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], pinned: collections.abc.Sequence[bool], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] | None, hold: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None) -> None:
        """
        fill, stiffness (m): filled fraction and painted multiplier of each tet; region_weights (m, S): each target set's part of a tet, rows sum to one; pinned (n) bool; weights (n, B) skin weights, any positive scale, or None where a transform of every free node is known instead: such a body has as many bones. hold (m), 1/m^2, or None: each target adds mu / 2 times the integral of hold |u - d|^2 to its energy.
        """
    def extend_shapes(self, embedding: Embedding, surfaces: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> numpy.typing.NDArray[numpy.float64]:
        """
        Node displacements (k, n, 3) that follow the surface displacements (k, V, 3): elastic in between, zero at pins.
        """
    @property
    def free_nodes(self) -> list[int]:
        ...
    @property
    def size(self) -> float:
        """
        Bounding-box diagonal, metres.
        """
    @property
    def volumes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Lumped volume of the free nodes by target set, m^3.
        """
class FullModel:
    """
    The unreduced soft skin.
    """
    def __init__(self, body: SoftBody, targets: collections.abc.Sequence[MorphTarget], law: Law, blending: Blending) -> None:
        ...
    def displacement(self, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Bind-space node displacement (n, 3), metres.
        """
    def energy(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> float:
        """
        Elastic energy, J, at target weights (J) and coordinates q.
        """
    def fallbacks(self, target: typing.SupportsInt | typing.SupportsIndex) -> int:
        """
        Tetrahedra of a target that keep the neutral rest shape, because the sculpt would invert or crush them.
        """
    def inertia(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], density: typing.SupportsFloat | typing.SupportsIndex) -> scipy.sparse.csc_matrix:
        """
        A^T M A in the model's coordinates at the bones' transforms (B, 3, 4).
        """
    def linear_modes(self, target: typing.SupportsInt | typing.SupportsIndex, k: typing.SupportsInt | typing.SupportsIndex) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]]:
        """
        (omega (k) rad/s, mass-orthonormal shapes (3 free, k)) at a target's shape.
        """
    def linearize(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> tuple[float, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], scipy.sparse.csc_matrix]:
        """
        (energy J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q; the stiffness of a full model is a scipy.sparse matrix.
        """
    def target(self, target: typing.SupportsInt | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Coordinates of a target's shape.
        """
    @property
    def body(self) -> SoftBody:
        ...
    @property
    def dofs(self) -> int:
        """
        Number of coordinates.
        """
class Basis:
    @property
    def U(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (3 free, r), orthonormal in unit-density mass.
        """
    @property
    def explained_variance(self) -> float:
        """
        Fraction of the candidates' variance in the span.
        """
class ReducedTables:
    """
    What a built reduced model stores: geometry only, no material.
    """
    def __init__(self, law: Law, basis: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], lame_lambda: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], lame_mu: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]]) -> None:
        ...
    @property
    def basis(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        ...
    @property
    def lame_lambda(self) -> list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Per target, for lambda = 1 Pa.
        """
    @property
    def lame_mu(self) -> list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Per target, for mu = 1 Pa.
        """
    @property
    def law(self) -> Law:
        ...
class ReducedModel:
    """
    The soft skin in r modes.
    """
    def __init__(self, body: SoftBody, targets: collections.abc.Sequence[MorphTarget], tables: ReducedTables, blending: Blending) -> None:
        ...
    def displacement(self, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Bind-space node displacement (n, 3), metres.
        """
    def energy(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> float:
        """
        Elastic energy, J, at target weights (J) and coordinates q.
        """
    def inertia(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], density: typing.SupportsFloat | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        A^T M A in the model's coordinates at the bones' transforms (B, 3, 4).
        """
    def linearize(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> tuple[float, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]]:
        """
        (energy J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q; the stiffness of a full model is a scipy.sparse matrix.
        """
    def target(self, target: typing.SupportsInt | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Coordinates of a target's shape.
        """
    @property
    def body(self) -> SoftBody:
        ...
    @property
    def dofs(self) -> int:
        """
        Number of coordinates.
        """
class Scheme:
    """
    Members:
    
      EULER
    
      BDF2
    """
    BDF2: typing.ClassVar[Scheme]
    EULER: typing.ClassVar[Scheme]
    __members__: typing.ClassVar[dict[str, Scheme]]
    @typing.overload
    def __eq__(self, other: Scheme) -> bool:
        ...
    @typing.overload
    def __eq__(self, other: typing.Any) -> bool:
        ...
    def __getstate__(self) -> int:
        ...
    def __hash__(self) -> int:
        ...
    def __index__(self) -> int:
        ...
    def __init__(self, value: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __int__(self) -> int:
        ...
    @typing.overload
    def __ne__(self, other: Scheme) -> bool:
        ...
    @typing.overload
    def __ne__(self, other: typing.Any) -> bool:
        ...
    def __repr__(self) -> str:
        ...
    def __setstate__(self, state: typing.SupportsInt | typing.SupportsIndex) -> None:
        ...
    def __str__(self) -> str:
        ...
    @property
    def name(self) -> str:
        ...
    @property
    def value(self) -> int:
        ...
class FullSimulation:
    """
    Steps a model through time. World space, SI.
    """
    def __init__(self, model: FullModel, h: typing.SupportsFloat | typing.SupportsIndex, *, scheme: Scheme = Scheme.BDF2, gravity: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ..., tolerance: typing.SupportsFloat | typing.SupportsIndex = 1e-06, max_iterations: typing.SupportsInt | typing.SupportsIndex = 30, teleport: typing.SupportsFloat | typing.SupportsIndex = 0.0, keep_going: typing.Any = None) -> None:
        """
        h: seconds a step; gravity (3,) m/s^2; teleport: jump of the skin off its course in one step, metres, above which the past is carried along (0: never); keep_going() -> bool is asked before every Newton iteration, False raises Cancelled.
        """
    def advance(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None) -> dict:
        """
        One step to each of the bones (S, B, 3, 4) and target weights (S, J); external (n, 3): newtons on the nodes, world space, constant over the call. Returns what the steps did: iterations in all, converged, the worst residual, elastic energy at the end, seconds.
        """
    def hold_targets(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        """
        Only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) acts.
        """
    def solve_static(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, guess: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], dict]:
        """
        (coordinates, report) of the static solution, sought from `guess` or from the blended targets.
        """
    def start(self, now: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], next: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> dict:
        """
        Static solution at the bones `now` (B, 3, 4); the past follows the rig backward from its motion to `next`.
        """
    @property
    def coordinates(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Of the last step, a copy: metres times the square root of cubic metres when reduced, metres when full.
        """
    @property
    def elastic_energy(self) -> float:
        """
        J, at the target weights of the last step.
        """
    @property
    def kinetic_energy(self) -> float:
        """
        J, of the posed nodes, by the scheme's own velocity.
        """
    @property
    def model(self) -> FullModel:
        ...
    @property
    def state(self) -> tuple[typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]], "FixedSize(4)"], typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 12]"]], "FixedSize(4)"]]:
        """
        (coordinates, bones' transforms (B, 12)), each now and at the last three steps: set it to resume.
        """
    @state.setter
    def state(self, arg1: tuple[typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], "FixedSize(4)"], typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 12]"]], "FixedSize(4)"]]) -> None:
        ...
class ReducedSimulation:
    """
    Steps a model through time. World space, SI.
    """
    def __init__(self, model: ReducedModel, h: typing.SupportsFloat | typing.SupportsIndex, *, scheme: Scheme = Scheme.BDF2, gravity: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ..., tolerance: typing.SupportsFloat | typing.SupportsIndex = 1e-06, max_iterations: typing.SupportsInt | typing.SupportsIndex = 30, teleport: typing.SupportsFloat | typing.SupportsIndex = 0.0, keep_going: typing.Any = None) -> None:
        """
        h: seconds a step; gravity (3,) m/s^2; teleport: jump of the skin off its course in one step, metres, above which the past is carried along (0: never); keep_going() -> bool is asked before every Newton iteration, False raises Cancelled.
        """
    def advance(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None) -> dict:
        """
        One step to each of the bones (S, B, 3, 4) and target weights (S, J); external (n, 3): newtons on the nodes, world space, constant over the call. Returns what the steps did: iterations in all, converged, the worst residual, elastic energy at the end, seconds.
        """
    def hold_targets(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        """
        Only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) acts.
        """
    def solve_static(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, guess: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], dict]:
        """
        (coordinates, report) of the static solution, sought from `guess` or from the blended targets.
        """
    def start(self, now: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], next: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> dict:
        """
        Static solution at the bones `now` (B, 3, 4); the past follows the rig backward from its motion to `next`.
        """
    @property
    def coordinates(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Of the last step, a copy: metres times the square root of cubic metres when reduced, metres when full.
        """
    @property
    def elastic_energy(self) -> float:
        """
        J, at the target weights of the last step.
        """
    @property
    def kinetic_energy(self) -> float:
        """
        J, of the posed nodes, by the scheme's own velocity.
        """
    @property
    def model(self) -> ReducedModel:
        ...
    @property
    def state(self) -> tuple[typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]], "FixedSize(4)"], typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 12]"]], "FixedSize(4)"]]:
        """
        (coordinates, bones' transforms (B, 12)), each now and at the last three steps: set it to resume.
        """
    @state.setter
    def state(self, arg1: tuple[typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], "FixedSize(4)"], typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 12]"]], "FixedSize(4)"]]) -> None:
        ...
class Crowd:
    """
    Many characters of one reduced model, stepped together. World space, SI.
    """
    def __init__(self, model: ReducedModel, h: typing.SupportsFloat | typing.SupportsIndex, size: typing.SupportsInt | typing.SupportsIndex, *, scheme: Scheme = Scheme.BDF2, gravity: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ..., tolerance: typing.SupportsFloat | typing.SupportsIndex = 1e-06, max_iterations: typing.SupportsInt | typing.SupportsIndex = 30, teleport: typing.SupportsFloat | typing.SupportsIndex = 0.0) -> None:
        """
        As ReducedSimulation; size: characters.
        """
    def advance(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> dict:
        """
        One step of all characters to each of the bones (S, N, B, 3, 4) and target weights (S, N, J). Returns what the steps did: iterations in all, steps of characters that had to be taken alone, converged, seconds.
        """
    def hold_targets(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        """
        Only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) acts.
        """
    def start(self, now: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], next: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> bool:
        """
        Static solutions of N characters at the bones `now` (N, B, 3, 4) and target weights (N, J); the past follows their rigs backward from their motion to `next`. False where one did not converge.
        """
    @property
    def coordinates(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        (N, r) of the last step, a copy.
        """
def closed_surface(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 3]"], dict]:
    """
    A closed surface with its faces outward, made of any triangle soup.
    
    vertices (V, 3): metres. triangles (T, 3): vertex indices. Vertices that lie together are welded, faces that are there
    twice dropped, faces turned outward, holes capped. Returns the vertices (W, 3), the triangles (U, 3), caps last, and
    what was wrong: counts by name. Raises Error when the input is empty, flat, not finite, or not between 1e-6 and 1e6 m across.
    """
def embed(mesh: TetMesh, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> Embedding:
    """
    Embeds surface points (V, 3), metres, by barycentric weights.
    
    A point outside takes the nearest tet, extrapolating as far as weights of -1/2.
    """
def extend_to_nodes(mesh: TetMesh, embedding: Embedding, values: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    Values (n, k) at the nodes from values (V, k) at the embedded points.
    
    Least squares at the points, smooth inside. Constants stay constant; overshoots slightly, so skin weights want clamping
    and normalising.
    """
def fill_fractions(mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], progress: typing.Any = None) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    Fraction (m,) of each tet that the body fills, 0.05 .. 1; any soup, which is closed first.
    
    vertices (V, 3): metres. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel.
    """
def instruction_set() -> str:
    """
    The instruction set that the engine's loops use: 'baseline', 'avx2' or 'avx512', the best that the processor has or what the environment variable DYNAMORPH_ISA named at the import. Results are the same bytes on all machines that use the same one.
    """
def make_basis(model: FullModel, r: typing.SupportsInt | typing.SupportsIndex, progress: typing.Any = None) -> Basis:
    """
    r modes: the targets' shapes exactly, then linear modes, modal derivatives and static responses by mass-PCA. progress(fraction) -> bool, False raises Cancelled.
    """
def make_cage(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], target_vertices: typing.SupportsInt | typing.SupportsIndex, thickness: typing.SupportsFloat | typing.SupportsIndex = 0.0, progress: typing.Any = None) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 3]"]]:
    """
    A closed cage of about `target_vertices` vertices around any triangle soup.
    
    vertices (V, 3): metres. triangles (T, 3): vertex indices. thickness: metres that the cage stands off at least. progress: called with 0..1, returns False to cancel.
    Returns vertices (C, 3) and outward triangles (D, 3). Raises Error when the input is empty, flat, not finite, or not
    between 1e-6 and 1e6 m across.
    """
def pinned(mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], heads: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tails: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], ratio: typing.SupportsFloat | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.bool]:
    """
    Whether the bones hold each node, bool (n,).
    
    A node is held when its distance to the nearest bone is less than `ratio` of the way from bone to skin: 0 holds none, 1
    all inside the body. vertices (V, 3), triangles (T, 3): the skin. heads, tails (B, 3): the bones at rest. All metres, in
    the mesh's space.
    """
def points_on_bones(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], skin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], skin_triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], heads: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tails: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], ratio: typing.SupportsFloat | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
    """
    Points (k, 3) along the bones, about as far apart as the cage's vertices, where the cage leaves room for them.
    
    As nodes they tie the flesh to a bone that would else pass between nodes; where there is room, three around the bone
    within what it holds (ratio, as for pinned), so that the body cannot spin about it. vertices (C, 3), triangles (D, 3): the cage.
    skin (V, 3), skin_triangles (T, 3): the body in it. heads, tails (B, 3): the bones at rest. All metres, in one space.
    """
def reduce(model: FullModel, U: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], progress: typing.Any = None) -> ReducedTables:
    """
    Energy polynomials of every target in the basis U (3 free, r).
    """
def set_threads(most: typing.SupportsInt | typing.SupportsIndex) -> None:
    """
    Use at most so many cores from now on; 0: all that the process may use. Results do not depend on it.
    """
def tetrahedralize(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], target_nodes: typing.SupportsInt | typing.SupportsIndex, inner: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = ...) -> TetMesh:
    """
    Fills a closed surface without self-intersections with about `target_nodes` nodes.
    
    vertices (V, 3): metres; they come first among the nodes. triangles (T, 3): vertex indices. inner (k, 3): points
    inside that become nodes. Raises Error when it cannot be filled. Crashes or hangs on some input: `mesh_body` contains that.
    """
def unpack_model(buffer: typing_extensions.Buffer) -> tuple[dict, str]:
    """
    (arrays by name, description as JSON) of a model file's bytes. Raises Error when they are damaged, or of a version that cannot be read.
    """
