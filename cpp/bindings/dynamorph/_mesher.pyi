"""
Dynamorph's mesher, which only its own process imports.
"""
from __future__ import annotations
import numpy
import numpy.typing
import typing
__all__: list[str] = ['tetrahedralize']
def tetrahedralize(vertices: typing.Annotated[numpy.typing.ArrayLike, numpy.float64], triangles: typing.Annotated[numpy.typing.ArrayLike, numpy.int32], target_nodes: typing.SupportsInt | typing.SupportsIndex, inner: typing.Annotated[numpy.typing.ArrayLike, numpy.float64] = ...) -> tuple[typing.Annotated[numpy.typing.NDArray[numpy.float64], "[m, 3]"], typing.Annotated[numpy.typing.NDArray[numpy.int32], "[m, 4]"]]:
    """
    Fills a closed surface that does not intersect itself with about `target_nodes` nodes.
    
    vertices (V, 3): meters; they become the first nodes. triangles (T, 3): vertex indices. inner (k, 3): points inside that
    become nodes too. Returns the nodes (n, 3) and the tets (m, 4) of a TetMesh. Raises Error when the surface cannot be
    filled. On some input this crashes or hangs; `mesh_body` runs it in a child process.
    """
