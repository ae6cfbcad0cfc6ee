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
__all__: list[str] = ['Basis', 'Blending', 'Cancelled', 'Collider', 'ColliderMotion', 'Contact', 'Coupling', 'Deformation', 'Embedding', 'Error', 'FullModel', 'Grabs', 'Integrator', 'LimitedTissue', 'LocalResponses', 'MaterialModel', 'MeshCut', 'MorphTarget', 'MotionLimit', 'PoseSpace', 'PosedShape', 'ReducedModel', 'ReducedTables', 'ResponseBasis', 'SelfContact', 'Simulation', 'Skin', 'SoftBody', 'State', 'StepReport', 'TargetSet', 'TetMesh', 'Thickness', 'adapt_response_basis', 'closed_surface', 'embed', 'extend_to_nodes', 'fill_fractions', 'instruction_set', 'make_basis', 'make_cage_surface', 'make_response_basis', 'measure_deformation', 'pinned', 'points_on_bones', 'reduce', 'set_threads', 'shape_by_physics', 'symmetric_like', 'unpack_model']
class Error(RuntimeError):
    """
    A body that cannot be simulated. The message says what to do.
    """
class Cancelled(RuntimeError):
    """
    A long call ended because its progress function returned False.
    """
class TetMesh:
    """
    A mesh of m tetrahedra and n nodes.
    """
    def __init__(self, nodes: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tets: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> None:
        """
        Makes a mesh from stored arrays.
        
        nodes (n, 3): rest positions, meters. tets (m, 4): node indices. Raises ValueError when an index is out of range, a
        coordinate is NaN, a tet is flat or inside out, or a node belongs to no tet.
        """
    @property
    def nodes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Rest positions (n, 3), meters.
        """
    @property
    def tets(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 4]"]:
        """
        Node indices (m, 4), positively oriented.
        """
    @property
    def volumes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Volumes (m,), cubic meters.
        """
class Embedding:
    """
    Where V surface points lie in a TetMesh.
    """
    def __init__(self, nodes: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 4]"]) -> None:
        """
        Restores an embedding from its nodes and weights (V, 4). Its distances are not known and read as 0.
        """
    def interpolate(self, values: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Interpolates values (n, k) at the nodes to values (V, k) at the points.
        """
    @property
    def distances(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Distances (V,) to the mesh, meters; 0 inside.
        """
    @property
    def nodes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 4]"]:
        """
        The nodes (V, 4) that carry each point, all of one tet.
        """
    @property
    def weights(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 4]"]:
        """
        Their weights (V, 4). Rows sum to 1; only points outside have negatives.
        """
class MeshCut:
    """
    Cuts apart tetrahedra that join distant parts of the skin, such as arm and torso.
    
    Two tetrahedra that share a face are glued when the path through the body between their skins is longer than 3 times the
    straight distance and longer than 4 times their longest edge. Loose parts of the skin, which no path joins, are not
    glued.
    """
    def __init__(self, mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> None:
        """
        Finds the glued tetrahedra.
        
        vertices (V, 3): meters. triangles (T, 3): the outward-facing skin in the mesh, open or closed. Raises ValueError on
        wrong shapes or indices, and on skin far larger than the mesh.
        """
    def cut(self) -> TetMesh:
        """
        Returns the TetMesh with a crack between glued tetrahedra.
        
        The tetrahedra stay the same. Nodes along the crack are duplicated, and the duplicates come last.
        """
    def embed(self, cut: TetMesh) -> Embedding:
        """
        Embeds the V vertices in the cut mesh, each in a tetrahedron that belongs to skin near it.
        """
    @property
    def glued(self) -> numpy.typing.NDArray[numpy.bool]:
        """
        Which tetrahedra are glued, bool (m,).
        """
class Thickness:
    """
    How thick a body is: the radius of the largest ball inside it that covers a point.
    
    Thickness is large in a belly and small in a finger, and it is continuous. Skin inside other skin does not count.
    """
    def __init__(self, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], progress: typing.Any = None) -> None:
        """
        Measures any triangle soup, which is closed first.
        
        vertices (V, 3): meters. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Raises
        Error like `closed_surface`.
        """
    def at(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Returns (thickness (k,), depth (k,)) at points (k, 3), all in meters.
        
        Depth is the distance to the skin, 0 outside the body. A point outside has the thickness of the skin nearest to it.
        """
    def covering(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tolerance: typing.SupportsFloat | typing.SupportsIndex) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Returns (centers (K, 3), radii (K,)) of few balls that fill the body, meters.
        
        They come as near to each of the points (k, 3) of the skin as tolerance times the thickness there, or as near as any
        ball in the body does.
        """
class Deformation:
    """
    What displacements do to a skin in each of F frames.
    """
    @property
    def farthest(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The largest displacement of each vertex (V,) in all frames, meters.
        """
    @property
    def flipped(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The share of the skin's area that is turned by more than 90 degrees (F,).
        """
    @property
    def largest(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The largest displacement of a vertex (F,), meters.
        """
    @property
    def longest(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Their 99.9th percentile (F,), in the mesh where it is highest; 1 without edges.
        """
    @property
    def percentile(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The 99.9th percentile of displacement (F,), meters.
        """
    @property
    def shortest(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The 0.1th percentile of the edges' lengths over those at rest (F,), in the mesh where it is lowest; 1 without edges.
        """
class TargetSet:
    """
    Targets whose weights sum to one.
    """
    def __init__(self, bones: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], names: collections.abc.Sequence[str], poses: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64]], radii: collections.abc.Sequence[typing.SupportsFloat | typing.SupportsIndex] = [], channels: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex] = [], values: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]] = []) -> None:
        """
        bones: indices of the bones; their local rotations place the targets. poses: for each target, the local transforms (B, 4, 4) of the whole skeleton. radii: for each target, the joint angle in radians at which it has faded out; 0, the default, means never. The first target gets the weight that the others lose, and its own radius is ignored. channels: indices of the channels that place the targets too; values: for each target, the values (C) of all channels.
        """
class PoseSpace:
    """
    Interpolates target weights over pose space.
    """
    def __init__(self, sets: collections.abc.Sequence[TargetSet]) -> None:
        """
        sets: their targets, one set after the other, are the columns of `weights`. Raises Error when two targets of a set have the same pose, and names both.
        """
    def distances(self, local: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], channels: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = ...) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Distances (S, J) in radians from the local transforms (S, B, 4, 4) and channels (S, C) to each target's pose: the root of the summed squares of the joint angles at the bones of its set, and of the ways along its channels, where that between the farthest values of a channel counts as a right angle.
        """
    def weights(self, local: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], channels: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = ...) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Weights (S, J) at the local transforms (S, B, 4, 4) and, where channels place targets, their values (S, C). The weights of each set are non-negative and sum to 1. At its own pose, a target has weight 1.
        """
    @property
    def targets(self) -> int:
        """
        Number of targets J, of all sets.
        """
class MaterialModel:
    """
    How stress follows from strain.
    
    Members:
    
      LINEAR : small strains: the fastest, but large rotations swell the body
    
      STVK : St. Venant-Kirchhoff: Green strains, which rotations leave alone
    
      STABLE_STVK : the same, and a body that is crushed pushes back
    """
    LINEAR: typing.ClassVar[MaterialModel]
    STABLE_STVK: typing.ClassVar[MaterialModel]
    STVK: typing.ClassVar[MaterialModel]
    __members__: typing.ClassVar[dict[str, MaterialModel]]
    @typing.overload
    def __eq__(self, other: MaterialModel) -> bool:
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
    def __ne__(self, other: MaterialModel) -> bool:
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
    How targets blend between their poses. Both are exact at each target's own pose.
    
    Members:
    
      FORCES : the weighted sum of the targets' forces: the stiffer shape dominates
    
      EVEN : also blends the shapes: halfway in pose is halfway in shape
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
    A dynamic morph target: a shape and its elastic properties.
    """
    @typing.overload
    def __init__(self, name: str, displacement: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], *, lame_lambda: typing.SupportsFloat | typing.SupportsIndex, lame_mu: typing.SupportsFloat | typing.SupportsIndex, density: typing.SupportsFloat | typing.SupportsIndex, mass_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, stiffness_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, set: typing.SupportsInt | typing.SupportsIndex = 0, shifted: bool = False) -> None:
        """
        displacement (n, 3): meters, bind space, zero at pinned nodes. Lame's parameters are in Pa, lame_lambda at most 100 times lame_mu, the density in kg/m^3, Rayleigh damping in 1/s (mass) and s (stiffness). set: index of the target set. shifted: the target has the elasticity of the neutral shape, moved by the displacement.
        """
    @typing.overload
    def __init__(self, name: str, displacement: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], *, young: typing.SupportsFloat | typing.SupportsIndex, poisson: typing.SupportsFloat | typing.SupportsIndex, density: typing.SupportsFloat | typing.SupportsIndex, mass_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, stiffness_damping: typing.SupportsFloat | typing.SupportsIndex = 0.0, set: typing.SupportsInt | typing.SupportsIndex = 0, shifted: bool = False) -> None:
        """
        As above, with the material given by Young's modulus (Pa) and Poisson's ratio (0 to 0.495).
        """
    @property
    def displacement(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        (n, 3): meters, bind space.
        """
    @property
    def name(self) -> str:
        ...
    @property
    def set(self) -> int:
        """
        Index of its target set.
        """
    @property
    def shifted(self) -> bool:
        """
        Whether it has the elasticity of the neutral shape, moved by its displacement.
        """
class SoftBody:
    """
    The data that all models of one character share.
    """
    def __init__(self, mesh: TetMesh, fill: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], region_weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], pinned: collections.abc.Sequence[bool], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] | None, hold: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None) -> None:
        """
        fill, stiffness (m): filled fraction and painted factor of each tet. region_weights (m, S): each target set's part of a tet; rows sum to one. pinned (n): bool. weights (n, B): skin weights at any positive scale, or None when every free node has its own transform; such a body has one bone per free node. hold (m): 1/m^2, or None. Each target adds mu / 2 times the integral of hold |u - d|^2 to its energy.
        """
    def extend_shapes(self, embedding: Embedding, surfaces: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> numpy.typing.NDArray[numpy.float64]:
        """
        Node displacements (k, n, 3) that follow the surface displacements (k, V, 3). They are elastic in between and zero at pinned nodes.
        """
    @property
    def free_nodes(self) -> list[int]:
        """
        Index of the node of each free node, those that are not pinned.
        """
    @property
    def size(self) -> float:
        """
        Bounding-box diagonal, meters.
        """
    @property
    def volumes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Lumped volumes of the free nodes by target set, m^3.
        """
class FullModel:
    """
    The unreduced soft skin.
    """
    def __init__(self, body: SoftBody, targets: collections.abc.Sequence[MorphTarget], material_model: MaterialModel, blending: Blending) -> None:
        """
        targets: of all sets; each set's first is its neutral one. Raises ValueError when a shape does not fit the body or displaces pinned nodes; `SoftBody.extend_shapes` makes shapes that do not.
        """
    def displacement(self, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Bind-space node displacement (n, 3), meters.
        """
    def energy(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> float:
        """
        Elastic energy, J, at target weights (J) and coordinates q.
        """
    def inertia(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], density: typing.SupportsFloat | typing.SupportsIndex) -> scipy.sparse.csc_matrix:
        """
        The mass matrix A^T M A in the model's coordinates, at the bones' transforms (B, 3, 4). That of a FullModel is a scipy.sparse matrix, for which SciPy must be installed.
        """
    def linear_modes(self, target: typing.SupportsInt | typing.SupportsIndex, k: typing.SupportsInt | typing.SupportsIndex) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]]:
        """
        Returns (omega (k) in rad/s, mass-orthonormal shapes (3 free, k)) at a target's shape. Raises Error when the body can move without resistance, as about a line on which all pinned nodes are.
        """
    def linearize(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> tuple[float, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], scipy.sparse.csc_matrix]:
        """
        Returns (energy in J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q. The stiffness of a FullModel is a scipy.sparse matrix, for which SciPy must be installed.
        """
    def target(self, target: typing.SupportsInt | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Coordinates of a target's shape.
        """
    @property
    def body(self) -> SoftBody:
        """
        The data that it shares with other models.
        """
    @property
    def dofs(self) -> int:
        """
        Number of coordinates.
        """
class PosedShape:
    """
    What `shape_by_physics` found.
    """
    @property
    def converged(self) -> bool:
        """
        Whether the last step ended.
        """
    @property
    def iterations(self) -> int:
        """
        Of Newton's method, in all steps.
        """
    @property
    def least_volume(self) -> float:
        """
        Of a tet with that displacement, in bind space, relative to rest.
        """
    @property
    def overlap(self) -> float:
        """
        How deep the skin is still in itself, meters: the bones leave no room there.
        """
    @property
    def overlaps(self) -> int:
        """
        The point that is deepest, or -1.
        """
    @property
    def plain(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        How much of plain skinning stays at each point (P), from 0 to 1, where it cannot be inverted.
        """
    @property
    def skin(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Displacements of the skin (P, 3), bind space, meters.
        """
class Basis:
    """
    The subspace of a soft skin: a few modes.
    """
    @property
    def U(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The modes (3 free, r), orthonormal in the mass for unit density.
        """
    @property
    def explained_variance(self) -> float:
        """
        Fraction of the candidates' variance that the basis spans.
        """
class ResponseBasis:
    """
    The subspace of a whole body: few modes and many responses.
    """
    @property
    def U(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The modes (3 free, r), orthonormal in the mass for unit density.
        """
    @property
    def W(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The responses (3 free, h), in which the energy stays quadratic.
        """
    @property
    def amplitudes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        How much each mode moves (r), relative to the others.
        """
class ReducedTables:
    """
    The tables that a built reduced model stores. They hold geometry only, no material.
    """
    def __init__(self, material_model: MaterialModel, basis: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], lame_lambda: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], lame_mu: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], responses: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] = ..., response_lambda: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]] = [], response_mu: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]] = [], relaxation: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]] = []) -> None:
        """
        Restores stored tables; `reduce` computes them. lame_lambda, lame_mu: for each target the coefficients of its tangent for lambda = 1 Pa and mu = 1 Pa: of the constant part K(k, l), of the linear one K(k, l, m) and of the quadratic one K(k, l, m, n), for k <= l <= m <= n with the last index fastest; for the linear law the first part only. docs/file_format.md has the layout of the others.
        """
    @property
    def basis(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The modes (3 free, r).
        """
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
    def material_model(self) -> MaterialModel:
        """
        How stress follows from strain.
        """
    @property
    def relaxation(self) -> list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]]:
        """
        Per target A (h, r): its tables are of the modes basis - responses A.
        """
    @property
    def response_lambda(self) -> list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Per target, stiffness and coupling of the responses for lambda = 1 Pa.
        """
    @property
    def response_mu(self) -> list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]]:
        """
        Per target, for mu = 1 Pa.
        """
    @property
    def responses(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The responses (3 free, h), or (0, 0).
        """
class ReducedModel:
    """
    The soft skin in r modes.
    """
    def __init__(self, body: SoftBody, targets: collections.abc.Sequence[MorphTarget], tables: ReducedTables, blending: Blending) -> None:
        """
        targets: those that the tables were computed for; their materials may have changed. Raises ValueError when a table does not fit them, or when a shape displaces pinned nodes.
        """
    def displacement(self, q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Bind-space node displacement (n, 3), meters.
        """
    def energy(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> float:
        """
        Elastic energy, J, at target weights (J) and coordinates q.
        """
    def inertia(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], density: typing.SupportsFloat | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        The mass matrix A^T M A in the model's coordinates, at the bones' transforms (B, 3, 4). That of a FullModel is a scipy.sparse matrix, for which SciPy must be installed.
        """
    def linearize(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> tuple[float, typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]]:
        """
        Returns (energy in J, force dE/dq, stiffness dF/dq) at target weights (J) and coordinates q. The stiffness of a FullModel is a scipy.sparse matrix, for which SciPy must be installed.
        """
    def target(self, target: typing.SupportsInt | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Coordinates of a target's shape.
        """
    @property
    def body(self) -> SoftBody:
        """
        The data that it shares with other models.
        """
    @property
    def dofs(self) -> int:
        """
        Number of coordinates.
        """
class Skin:
    """
    P points that move with a model: x = A (X + E u(q) + R w) + a. Simulations may share it.
    """
    def __init__(self, model: FullModel | ReducedModel, rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], embedding: Embedding, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], residual_shapes: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None) -> None:
        """
        rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. weights (P, B): skin weights at any positive scale; those below 1 % do not count. residual_shapes (J, P, 3): what the mesh cannot carry of each target's shape, or None.
        """
    def displacement(self, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        E u(q) + R w (P, 3), meters, bind space, at target weights (J) and coordinates q.
        """
    def positions(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], q: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        x (P, 3), meters, world space, at the bones' transforms (B, 3, 4).
        """
    def pull_back(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], forces: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Forces on the coordinates (dofs) that do the work of forces on the points (P, 3), newtons, world space.
        """
class Collider:
    """
    A triangle mesh that soft skins run into. Simulations may share it.
    """
    def __init__(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], one_sided: bool = False) -> None:
        """
        points (V, 3): meters, in its own frame. triangles (T, 3): any triangle soup; closed parts push outward, open ones from both sides. one_sided: all that is behind its faces counts as inside, unless both sides of one are there. Raises ValueError without triangles, for indices out of range and for points that are not finite.
        """
    def signed_distances(self, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Of points (N, 3) from the mesh as it was built, in its own frame: (N,), meters, negative inside. An open part that is not one-sided has no inside. Raises ValueError for points that are not finite.
        """
class ColliderMotion:
    """
    Where a collider is during S steps, in world space.
    """
    def __init__(self, collider: Collider, motion: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], friction: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = 0.5, active: typing.Annotated[numpy.typing.ArrayLike, numpy.bool] = True) -> None:
        """
        motion: meters, a rigid collider's transforms (S + 1, 3, 4) or a deforming one's points (S + 1, V, 3), the first at the beginning of the first step, each other at the end of one. They need not be finite: where they are not, nothing touches the collider. friction: Coulomb's coefficient, for each step (S) or for all. active: whether something can touch it, for each step (S) or for all.
        """
class LocalResponses:
    """
    How patches of a skin give way where something presses, which a reduced model's coordinates cannot do. Simulations may share it.
    """
    def __getstate__(self) -> tuple:
        ...
    def __init__(self, model: FullModel, basis: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], normals: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], embedding: Embedding, centers: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], corners: typing.Annotated[numpy.typing.ArrayLike, numpy.int32] | None = None, corner_weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 3]"] | None = None) -> None:
        """
        model: the unreduced one. basis (3 free, dofs): the reduced model's. rest (L, 3): places that are spread evenly over the soft skin, meters, bind space; normals (L, 3): outward, any length; embedding: of the skin's V vertices. centers (P): those in the middle of a patch. corners (L, 3), corner_weights (L, 3): the places are means of these vertices; by default they are the vertices.
        """
    def __setstate__(self, arg0: tuple) -> None:
        ...
    @property
    def shapes(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        Displacement (3 free, P) of the free nodes by a unit of each patch's amplitude, which has a mean square of one over the body's volume.
        """
    @property
    def stiffness(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        C (P, P) of the energy a^T C a / 2, at the neutral targets.
        """
class Contact:
    """
    The points of a model's skin that can touch colliders. Simulations may share them.
    """
    def __init__(self, model: FullModel | ReducedModel, rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], embedding: Embedding, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], normals: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], thickness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], residual_shapes: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, local: LocalResponses | None = None, corners: typing.Annotated[numpy.typing.ArrayLike, numpy.int32] | None = None, corner_weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 3]"] | None = None, found: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] | None = None) -> None:
        """
        rest (V, 3): the skin's vertices, meters, bind space. embedding: of these in the body's mesh. weights (V, B): skin weights at any positive scale; those below 1 % do not count. corners (P, 3), corner_weights (P, 3): the points are means of these vertices, with weights that sum to one; by default they are the vertices. normals (P, 3): out of the body, bind space. thickness (P): of the tissue below, meters; a collider that the bones take in by more pushes less, and by 1.2 times that not at all. residual_shapes (J, V, 3): what the mesh cannot carry of each target's shape, or None. local: how a reduced model's skin gives way; None for an unreduced one. found: that of the same points before, so that it is not found again.
        """
    @property
    def found(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
        """
        What takes long to find of each point (P, 3): its `stiffness`, the mass that it moves (kg), and the part of a push that a reduced model's coordinates take.
        """
    @property
    def stiffness(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        The model's own stiffness at each point (P) along its normal, N/m, at the neutral targets; 0 where pins hold it.
        """
class SelfContact:
    """
    Where the skin of a model touches the same skin. Simulations may share it.
    """
    def __init__(self, contact: Contact, centers: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], radii: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], embedding: Embedding, weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], points: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], of_balls: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], of_points: collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], joints: collections.abc.Sequence[typing.Annotated[collections.abc.Sequence[typing.SupportsInt | typing.SupportsIndex], "FixedSize(2)"]] = []) -> None:
        """
        contact: the points of the skin. centers (K, 3), radii (K): of balls that fill the body, meters, bind space, as `Thickness.covering` finds them. embedding: of the centers in the body's mesh. weights (K, B): skin weights of the centers. points (P): numbers of those points that touch the balls, ascending; a few thousand, spread evenly. of_balls (K), of_points (P): which parts of the body they belong to, as the bones that move them most; within a part nothing touches. joints: pairs of parts that share skin. What a point touches at rest, or nearly, it does not touch. Raises ValueError for arrays that do not fit each other.
        """
class Integrator:
    """
    How a step goes on in time. Both are implicit.
    
    Members:
    
      EULER : first order: it damps motion of itself, the more the longer the step
    
      BDF2 : second order: it damps motion much less
    """
    BDF2: typing.ClassVar[Integrator]
    EULER: typing.ClassVar[Integrator]
    __members__: typing.ClassVar[dict[str, Integrator]]
    @typing.overload
    def __eq__(self, other: Integrator) -> bool:
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
    def __ne__(self, other: Integrator) -> bool:
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
class Grabs:
    """
    Springs that pull points of a skin to places in the world.
    """
    def __init__(self, skin: Skin, points: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], goals: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        """
        skin: of the simulation's model. points (K): of the skin. goals (S, K, 3): meters, world space, at the end of each step. stiffness (K), or (S, K) for each step: N/m.
        """
class LimitedTissue:
    """
    Which points and edges of a skin the limits of its motion look at, and what moves there.
    """
    def __getstate__(self) -> tuple:
        ...
    def __setstate__(self, arg0: tuple) -> None:
        ...
class MotionLimit:
    """
    How far a moving rig may drive the skin of a model. Simulations may share it.
    """
    def __init__(self, model: FullModel | ReducedModel, rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], embedding: Embedding, triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], distances: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], groups: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"] | None = None, painted: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None, *, stretch: typing.SupportsFloat | typing.SupportsIndex = 0.4, edges_between: typing.SupportsInt | typing.SupportsIndex = 400, tissue: LimitedTissue | None = None) -> None:
        """
        rest (P, 3): meters, bind space. embedding: of the P points in the body's mesh. triangles (T, 3): of the soft skin. weights (P, G): skin weights of the bones. distances (P): the largest from the targets' shape, meters. groups (free nodes, G): the bones' parts in nodes with transforms of their own, otherwise None. painted (P) in (0, 1]: factors on the distances from which points are pulled back, or None for ones. The others are LimitConstants, which docs/limit.md tables: stretch, of an edge's length, by which it may change; edges_between, how many more than the most stretched are pulled back. tissue: that of a limit that differs from this in its distances alone, or None to find it, which takes most of the time. Raises ValueError for constants below zero and a tissue of another skin, and Error if the tissue has no stiffness at rest.
        """
    @property
    def frequency(self) -> float:
        """
        Of the neutral tissue, 1/s (angular).
        """
    @property
    def numbers(self) -> int:
        """
        How many numbers of a static answer are looked at.
        """
    @property
    def tissue(self) -> LimitedTissue:
        """
        What was found of the skin. It can be pickled.
        """
class State:
    """
    Where a soft skin is, and what its next steps depend on besides. Keep one to resume, undo or fork a simulation.
    """
    def __init__(self, coordinates: typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"]], "FixedSize(4)"], bones: typing.Annotated[collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 12]"]], "FixedSize(4)"], limit: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] = ..., contact: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] = ..., dents: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] = ...) -> None:
        ...
    @property
    def bones(self) -> typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 12]"]], "FixedSize(4)"]:
        """
        Transforms (B, 12) of the bones, bind to world space, likewise.
        """
    @property
    def contact(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        What is touched (any); empty where nothing is.
        """
    @property
    def coordinates(self) -> typing.Annotated[list[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]], "FixedSize(4)"]:
        """
        Coordinates (dofs), now and at the last three steps. The unit is meters times the square root of cubic meters for a reduced model, and meters for a full one.
        """
    @property
    def dents(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        Amplitudes of the contact's local responses (P); empty without.
        """
    @property
    def limit(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        What the motion limit remembers of the load (any); empty without one, or where it has not acted.
        """
class StepReport:
    """
    What steps, or a static solution, say of themselves.
    """
    def __init__(self) -> None:
        """
        Of no steps.
        """
    @property
    def body_force(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[3, 1]"]:
        """
        Newtons (3) that the others of a coupling pushed it with in the last step.
        """
    @property
    def contact_forces(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
        """
        Newtons on each collider (C, 3) in the last step.
        """
    @property
    def contacts(self) -> int:
        """
        The largest number of points that were pushed in a step.
        """
    @property
    def converged(self) -> bool:
        """
        Whether each met its tolerance. The state is finite anyway.
        """
    @property
    def energy(self) -> float:
        """
        Elastic energy at the end, J.
        """
    @property
    def excess(self) -> float:
        """
        With a motion limit: the largest excess of a bone's load, which was held back if that is above 1/2.
        """
    @property
    def excess_bone(self) -> int:
        """
        Which bone's; -1 without a limit.
        """
    @property
    def farthest(self) -> float:
        """
        The largest distance of a point from its targets' shape, relative to its limit.
        """
    @property
    def iterations(self) -> int:
        """
        Of Newton's method, in all; of a coupling, those of all.
        """
    @property
    def penetration(self) -> float:
        """
        The largest depth of a point under a surface, meters, where the bones leave it room.
        """
    @property
    def pulled(self) -> int:
        """
        In how many steps a limit pulled anything back.
        """
    @property
    def residual(self) -> float:
        """
        The worst one: the gradient relative to the largest force.
        """
    @property
    def seconds(self) -> float:
        """
        How long they took; of a coupling, an equal share.
        """
    @property
    def steps(self) -> int:
        """
        How many there were.
        """
    @property
    def teleported(self) -> bool:
        """
        Whether the rig jumped, so that the past was carried along.
        """
    @property
    def too_deep(self) -> float:
        """
        How deep a point stays in a collider, or in the body itself, where the bones take it deeper than it can give way; meters, 0: nowhere.
        """
    @property
    def too_deep_collider(self) -> int:
        """
        In which collider; -1: in the body, below that: of a coupling, -2 less the number of another body.
        """
    @property
    def too_deep_sample(self) -> int:
        """
        Which point of the contact; -1: none.
        """
    @property
    def unusable_colliders(self) -> list[int]:
        """
        Numbers of those that were active, but not finite or without extent.
        """
class Simulation:
    """
    Steps a model through time, in world space and SI units.
    """
    def __init__(self, model: FullModel | ReducedModel, h: typing.SupportsFloat | typing.SupportsIndex, *, limit: MotionLimit | None = None, contact: Contact | None = None, distance: typing.SupportsFloat | typing.SupportsIndex = 0.0, self_contact: SelfContact | None = None, self_friction: typing.SupportsFloat | typing.SupportsIndex = 0.5, integrator: Integrator = Integrator.BDF2, gravity: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 1]"] = ..., tolerance: typing.SupportsFloat | typing.SupportsIndex = 1e-06, max_iterations: typing.SupportsInt | typing.SupportsIndex = 30, teleport: typing.SupportsFloat | typing.SupportsIndex = 0.0, keep_going: typing.Any = None) -> None:
        """
        h: seconds per step. limit: of the motion. contact: the points that the colliders of `advance` push, from a distance in meters on. self_contact: of those points, where the skin touches itself, with self_friction. gravity (3,): m/s^2. teleport: the jump of the skin off its course in one step, meters, above which the past is carried along (0: never). keep_going() -> bool is called before every Newton iteration; returning False raises Cancelled. Raises ValueError for parts of another model.
        """
    def advance(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, grabs: Grabs | None = None, colliders: collections.abc.Sequence[ColliderMotion] | None = None, stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, distance: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, self_friction: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None) -> StepReport:
        """
        Takes one step to each of the bones (S, B, 3, 4) and target weights (S, J). external: newtons on the nodes, world space, (S, n, 3) or the same at all steps (n, 3). grabs: of points of a skin. colliders: what pushes the points of its contact. stiffness (S, J): how many times as stiff as its material each target is. distance (S): at which contact begins, meters, and self_friction (S): instead of the simulation's. Returns a StepReport.
        """
    def balance_targets(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> None:
        """
        Lets only the difference between gravity in a pose and gravity in the targets' own poses (J, B, 3, 4) act, so that targets do not sag.
        """
    def solve_static(self, bones: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], external: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None = None, guess: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None, stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"], StepReport]:
        """
        Returns (coordinates, StepReport) of the static solution. The search starts from `guess`, or from the blended targets.
        """
    def start(self, now: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], next: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], colliders: collections.abc.Sequence[ColliderMotion] | None = None, stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"] | None = None, distance: typing.SupportsFloat | typing.SupportsIndex | None = None, self_friction: typing.SupportsFloat | typing.SupportsIndex | None = None, grabs: Grabs | None = None) -> StepReport:
        """
        Starts from the static solution at the bones `now` (B, 3, 4). The past continues the motion from `now` to `next` backward. grabs: what pulls the skin then, with goals of one step. colliders: what the skin lies on then, each with the motion of one step in which it stays where it is. stiffness (J), distance, self_friction: as of `advance`, then.
        """
    @property
    def coordinates(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        A copy of the coordinates after the last step, as of `State`.
        """
    @property
    def dents(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        A copy of the amplitudes of its contact's local responses after the last step, as of `State`.
        """
    @property
    def elastic_energy(self) -> float:
        """
        Elastic energy, J, at the target weights of the last step.
        """
    @property
    def excess(self) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
        """
        By how much each bone's load (G) exceeded its limit in the last step: above 1/2 it was held back. Empty without a motion limit.
        """
    @property
    def kinetic_energy(self) -> float:
        """
        Kinetic energy of the posed nodes, J, from the integrator's own velocity.
        """
    @property
    def model(self) -> FullModel | ReducedModel:
        """
        The model that it steps.
        """
    @property
    def state(self) -> State:
        """
        A copy of its State. Set it to resume a simulation; raises Error for what is not finite.
        """
    @state.setter
    def state(self, arg1: State) -> None:
        ...
class Coupling:
    """
    Soft bodies that press on each other and take their steps together: both sides give way.
    """
    def __init__(self, bodies: collections.abc.Sequence[tuple[Simulation, SelfContact]], friction: typing.SupportsFloat | typing.SupportsIndex = 0.0, garments: collections.abc.Sequence[tuple[typing.SupportsInt | typing.SupportsIndex, typing.SupportsInt | typing.SupportsIndex, typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[3, 4]"]]] = []) -> None:
        """
        bodies: two simulations at least, of models of one kind, each with its skin, that of its contact. friction: of skin on skin. garments: (clothes, body, to_body), numbers of clothes that lie on a body at rest and of that, and the transform (3, 4) of the bind space of the first to that of the second. Raises ValueError for others, or if their time steps or integrators differ.
        """
    def advance(self, motions: collections.abc.Sequence[tuple[typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.Annotated[numpy.typing.ArrayLike, numpy.float64], typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None, Grabs | None, collections.abc.Sequence[ColliderMotion] | None, typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None, typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None, typing.Annotated[numpy.typing.ArrayLike, numpy.float64] | None]]) -> list[StepReport]:
        """
        As `advance` of one simulation, for all bodies: motions has, for each, (bones, weights, external, grabs, colliders, stiffness, distance, self_friction). Returns a StepReport of each.
        """
def adapt_response_basis(model: FullModel, U: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], W: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"]) -> ResponseBasis:
    """
    The same modes U (3 free, r), and responses of the span of W (3 free, h) that decouple with the model's stiffness, which may be another one than they were made for.
    """
def closed_surface(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 3]"], dict]:
    """
    Turns any triangle soup into a closed surface with outward faces.
    
    vertices (V, 3): meters. triangles (T, 3): vertex indices. Vertices at the same place are welded, duplicate faces are
    dropped, faces are turned outward, and holes are capped. Returns the vertices (W, 3), the triangles (U, 3) with the caps
    last, and the counts of defects by name. Raises Error when the input is empty, flat, not finite, or not between 1e-6 and
    1e6 m across.
    """
def embed(mesh: TetMesh, points: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> Embedding:
    """
    Embeds surface points (V, 3), meters, by barycentric weights.
    
    A point outside the mesh uses the nearest tet. Its weights are extrapolated, but not below -1/2.
    """
def extend_to_nodes(mesh: TetMesh, embedding: Embedding, values: typing.Annotated[numpy.typing.ArrayLike, numpy.float64]) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, n]"]:
    """
    Extends values (V, k) at the embedded points to values (n, k) at the nodes.
    
    The fit is least squares at the points and smooth inside. Constants stay constant. Values overshoot slightly, so clamp
    and normalize skin weights afterward.
    """
def fill_fractions(mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], progress: typing.Any = None) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 1]"]:
    """
    Fraction (m,) of each tet that the body fills, 0.05 .. 1.
    
    The body may be any triangle soup; it is closed first. vertices (V, 3): meters. triangles (T, 3): vertex indices.
    progress: called with 0..1, returns False to cancel.
    """
def instruction_set() -> str:
    """
    The instruction set that the engine's loops use: 'baseline', 'avx2' or 'avx512'. It is the best that the processor has, or the one that the environment variable DYNAMORPH_ISA named at import. Results are byte-identical on all machines that use the same one.
    """
def make_basis(model: FullModel, r: typing.SupportsInt | typing.SupportsIndex, progress: typing.Any = None) -> Basis:
    """
    Makes r modes. They span the targets' shapes exactly, then linear modes, modal derivatives and static responses by mass-PCA. progress(fraction) -> bool: returning False raises Cancelled. Raises Error when the body can move without resistance.
    """
def make_cage_surface(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], target_vertices: typing.SupportsInt | typing.SupportsIndex, progress: typing.Any = None) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 3]"]]:
    """
    Wraps a closed cage of about `target_vertices` vertices around any triangle soup.
    
    vertices (V, 3): meters. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Returns
    vertices (C, 3) and outward triangles (D, 3). Raises Error when the input is empty, flat, not finite, or not between 1e-6
    and 1e6 m across.
    """
def make_response_basis(model: FullModel, r: typing.SupportsInt | typing.SupportsIndex, h: typing.SupportsInt | typing.SupportsIndex, progress: typing.Any = None) -> ResponseBasis:
    """
    Makes r modes and h responses from the static answers to what the bones can do. The modes span the targets' shapes exactly. progress(fraction) -> bool: returning False raises Cancelled. Raises Error when the body can move without resistance.
    """
def measure_deformation(rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], edges: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.int32]], coordinates: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], modes: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], progress: typing.Any = None) -> Deformation:
    """
    Measures how far displacements move a skin, and how much they stretch it and turn it over.
    
    rest (V, 3): the skin, meters. triangles (T, 3): vertex indices. edges: an array (E, 2) of vertex indices for each mesh
    of the skin, because a small mesh that is torn is visible too. The displacements in F frames are coordinates (F, r) times
    modes (r, V, 3), meters; only a few frames are in memory at a time. To measure displacements (k, V, 3) themselves, pass
    them as modes with an identity matrix as coordinates. progress: called with 0..1, returns False to cancel.
    
    A quantile of displacement counts vertices by the area around them, one of stretch counts edges by their length at rest:
    it is the smallest value up to which there is that share of all area or length. Vertices around which no triangle has an
    area count in `farthest` alone. Raises ValueError on wrong shapes or indices, edges without a length, and numbers that
    are not finite.
    """
def pinned(mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], heads: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tails: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], ratio: typing.SupportsFloat | typing.SupportsIndex) -> numpy.typing.NDArray[numpy.bool]:
    """
    Whether the bones pin each node, bool (n,).
    
    A node is pinned when its distance to the nearest bone is less than `ratio` of the way from bone to skin: 0 pins none, 1
    pins all nodes inside the body. vertices (V, 3), triangles (T, 3): the skin. heads, tails (B, 3): the bones at rest. All
    are in meters and in the mesh's space.
    """
def points_on_bones(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], skin: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], skin_triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], heads: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], tails: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], ratio: typing.SupportsFloat | typing.SupportsIndex) -> typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"]:
    """
    Points (k, 3) along the bones, about as far apart as the cage's vertices, where the cage leaves room for them.
    
    As nodes, they tie the soft tissue to a bone that would otherwise pass between nodes. Where there is room, three points
    surround the bone within the range that it pins (`ratio`, as for `pinned`), so that the body cannot spin about the bone.
    vertices (C, 3), triangles (D, 3): the cage. skin (V, 3), skin_triangles (T, 3): the body in it. heads, tails (B, 3):
    the bones at rest. All are in meters and in one space.
    """
@typing.overload
def reduce(model: FullModel, U: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], progress: typing.Any = None) -> ReducedTables:
    """
    Computes the energy polynomials of every target in the basis U (3 free, r).
    """
@typing.overload
def reduce(model: FullModel, basis: Basis, progress: typing.Any = None) -> ReducedTables:
    """
    As above, in the basis that `make_basis` returned.
    """
@typing.overload
def reduce(model: FullModel, basis: ResponseBasis, progress: typing.Any = None) -> ReducedTables:
    """
    The same in a basis with responses, whose stiffness and coupling are computed too.
    """
def set_threads(limit: typing.SupportsInt | typing.SupportsIndex) -> None:
    """
    Uses at most this many cores from now on; 0 means all that the process may use. Results do not depend on it.
    """
def shape_by_physics(mesh: TetMesh, stiffness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], rest: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], embedding: Embedding, skin_weights: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, n]"], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], thickness: typing.Annotated[numpy.typing.ArrayLike, numpy.float64, "[m, 1]"], path: collections.abc.Sequence[typing.Annotated[numpy.typing.ArrayLike, numpy.float64]], progress: typing.Any = None) -> PosedShape:
    """
    The shape that a soft body has in a pose, found by statics: what an artist would sculpt there.
    
    stiffness (m): of each tet, relative to the others. weights (n, B) of the nodes and skin_weights (P, B) at any positive
    scale. rest (P, 3), embedding: of the skin, bind space, meters. triangles (T, 3): of the skin, outward. thickness (P):
    from the skin to the middle of the body, meters. path: skin transforms (B, 3, 4) of the bones, from near rest to the
    pose. progress: called with 0..1, returns False to cancel. Raises Error for transforms that are not finite.
    """
def symmetric_like(mesh: TetMesh, vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32]) -> TetMesh:
    """
    Returns a mirror-symmetric mesh for a mirror-symmetric skin.
    
    Half of the mesh and its mirror image, whose nodes and tets come last, if the mirror image of the skin about the middle
    of one of its axes, X first, is nowhere farther from it than 1/500 of its diagonal. The same mesh otherwise. vertices
    (V, 3): meters. triangles (T, 3): vertex indices.
    """
def unpack_model(buffer: typing_extensions.Buffer) -> tuple[dict, str]:
    """
    Returns (arrays by name, description as JSON) from a model file's bytes. Raises Error when the bytes are damaged, or of a version that cannot be read.
    """
