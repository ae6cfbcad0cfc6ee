// SPDX-License-Identifier: GPL-3.0-or-later
#include "arrays.hpp"
#include "bindings.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/mesh/cage.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/fill.hpp"
#include "dynamorph/mesh/mesh_cut.hpp"
#include "dynamorph/mesh/pins.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"
#include "dynamorph/mesh/tetrahedralize.hpp"
#include "dynamorph/mesh/thickness.hpp"

using namespace dynamorph;

namespace {

Points points(const FloatArray& array, const char* name) { return to_matrix<Points>(array, name); }
Triangles triangles(const IndexArray& array) { return to_indices<Triangles>(array, "triangles"); }

void check_rows(const FloatArray& array, const char* name, Eigen::Index expected) {
  if (array.shape(0) != expected)
    throw std::invalid_argument(std::string(name) + ": expected " + std::to_string(expected) + " rows, got shape " +
                                shape_of(array));
}

py::array_t<bool> to_array(const std::vector<bool>& flags) {
  py::array_t<bool> array(flags.size());
  std::copy(flags.begin(), flags.end(), array.mutable_data());
  return array;
}

void bind_tet_mesh(py::module_& m) {
  py::class_<TetMesh>(m, "TetMesh", "Tetrahedra: n nodes, m tets.")
      .def(py::init([](const FloatArray& nodes, const IndexArray& tets) {
             return make_tet_mesh(points(nodes, "nodes"), to_indices<Tets>(tets, "tets"));
           }),
           "nodes"_a, "tets"_a, R"(A mesh from stored arrays.

nodes (n, 3): rest positions, metres. tets (m, 4): node indices. Raises ValueError on an index out of range, a NaN, a
tet that is flat or inside out, or a node of no tet.)")
      .def_readonly("nodes", &TetMesh::nodes, "Rest positions (n, 3), metres.")
      .def_readonly("tets", &TetMesh::tets, "Node indices (m, 4), positively oriented.")
      .def_property_readonly("volumes", &volumes, "Volumes (m,), cubic metres.");

  py::class_<Embedding>(m, "Embedding", "Where V surface points sit in a TetMesh.")
      .def(py::init([](const IndexArray& array, const decltype(Embedding::weights)& weights) {
             const Tets nodes = to_indices<Tets>(array, "nodes");
             if (nodes.rows() != weights.rows() || (nodes.size() > 0 && nodes.minCoeff() < 0))
               throw std::invalid_argument("nodes, weights: expected one row a point, and no negative node");
             return Embedding{nodes, weights, VectorXd::Zero(nodes.rows())};
           }),
           "nodes"_a, "weights"_a, "One that was kept: nodes, weights (V, 4); its distances are not known.")
      .def_readonly("nodes", &Embedding::nodes, "The nodes (V, 4) that carry each point: those of one tet.")
      .def_readonly("weights", &Embedding::weights, "Their weights (V, 4): rows sum to 1; negative only outside.")
      .def_readonly("distances", &Embedding::distances, "Distance (V,) to the mesh, metres: 0 inside.")
      .def(
          "interpolate",
          [](const Embedding& self, const FloatArray& values) {
            const auto matrix = to_matrix<RowMajor>(values, "values");
            if (self.nodes.size() && self.nodes.maxCoeff() >= matrix.rows())
              throw std::invalid_argument("values: expected one row a node, got shape " + shape_of(values));
            return without_gil([&] { return RowMajor(self.matrix(matrix.rows()) * matrix); });
          },
          "values"_a, "Values (V, k) at the points from values (n, k) at the nodes.");
}

py::dict to_dict(const Defects& d) {
  return py::dict("boundary_loops"_a = d.boundary_loops, "open_edges"_a = d.open_edges,
                  "nonmanifold_edges"_a = d.nonmanifold_edges, "flipped_faces"_a = d.flipped_faces,
                  "duplicate_faces"_a = d.duplicate_faces, "degenerate_faces"_a = d.degenerate_faces,
                  "stray_vertices"_a = d.stray_vertices, "components"_a = d.components);
}

void bind_meshers(py::module_& m) {
  m.def(
      "closed_surface",
      [](const FloatArray& vertices, const IndexArray& faces) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        const ClosedSurface closed = without_gil([&] { return close_surface(v, f); });
        return py::make_tuple(closed.vertices, closed.triangles, to_dict(closed.defects));
      },
      "vertices"_a, "triangles"_a, R"(A closed surface with its faces outward, made of any triangle soup.

vertices (V, 3): metres. triangles (T, 3): vertex indices. Vertices that lie together are welded, faces that are there
twice dropped, faces turned outward, holes capped. Returns the vertices (W, 3), the triangles (U, 3), caps last, and
what was wrong: counts by name. Raises Error when the input is empty, flat, not finite, or not between 1e-6 and 1e6 m across.)");
  m.def(
      "make_cage",
      [](const FloatArray& vertices, const IndexArray& faces, int target_vertices, double thickness,
         const py::object& progress) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        const ProgressFn report = with_gil(progress);
        Cage cage = without_gil([&] { return make_cage(v, f, target_vertices, thickness, report); });
        return std::make_pair(std::move(cage.vertices), std::move(cage.triangles));
      },
      "vertices"_a, "triangles"_a, "target_vertices"_a, "thickness"_a = 0.0, "progress"_a = py::none(),
      R"(A closed cage of about `target_vertices` vertices around any triangle soup.

vertices (V, 3): metres. triangles (T, 3): vertex indices. thickness: metres that the cage stands off at least. progress: called with 0..1, returns False to cancel.
Returns vertices (C, 3) and outward triangles (D, 3). Raises Error when the input is empty, flat, not finite, or not
between 1e-6 and 1e6 m across.)");
  m.def(
      "tetrahedralize",
      [](const FloatArray& vertices, const IndexArray& faces, int target_nodes, const FloatArray& inner) {
        const Points v = points(vertices, "vertices"), more = points(inner, "inner");
        const Triangles f = triangles(faces);
        return without_gil([&] { return tetrahedralize(v, f, target_nodes, more); });
      },
      "vertices"_a, "triangles"_a, "target_nodes"_a, "inner"_a = Points(0, 3),
      R"(Fills a closed surface without self-intersections with about `target_nodes` nodes.

vertices (V, 3): metres; they come first among the nodes. triangles (T, 3): vertex indices. inner (k, 3): points
inside that become nodes. Raises Error when it cannot be filled. Crashes or hangs on some input: `mesh_body` contains that.)");
}

void bind_body_in_mesh(py::module_& m) {
  m.def(
      "embed",
      [](const TetMesh& mesh, const FloatArray& array) {
        const Points p = points(array, "points");
        return without_gil([&] { return embed(mesh, p); });
      },
      "mesh"_a, "points"_a, R"(Embeds surface points (V, 3), metres, by barycentric weights.

A point outside takes the nearest tet, extrapolating as far as weights of -1/2.)");
  m.def(
      "fill_fractions",
      [](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces, const py::object& progress) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        const ProgressFn report = with_gil(progress);
        return without_gil([&] { return fill_fractions(mesh, v, f, report); });
      },
      "mesh"_a, "vertices"_a, "triangles"_a, "progress"_a = py::none(),
      R"(Fraction (m,) of each tet that the body fills, 0.05 .. 1; any soup, which is closed first.

vertices (V, 3): metres. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel.)");
  m.def(
      "extend_to_nodes",
      [](const TetMesh& mesh, const Embedding& embedding, const FloatArray& values) {
        const MatrixXd v = to_matrix<RowMajor>(values, "values");
        check_rows(values, "values", embedding.nodes.rows());
        if (embedding.nodes.size() > 0 && embedding.nodes.maxCoeff() >= mesh.nodes.rows())
          throw std::invalid_argument("embedding: is of another mesh");
        return without_gil([&] { return RowMajor(extend_to_nodes(mesh, embedding, v)); });
      },
      "mesh"_a, "embedding"_a, "values"_a, R"(Values (n, k) at the nodes from values (V, k) at the embedded points.

Least squares at the points, smooth inside. Constants stay constant; overshoots slightly, so skin weights want clamping
and normalising.)");
  m.def(
      "points_on_bones",
      [](const FloatArray& vertices, const IndexArray& faces, const FloatArray& skin, const IndexArray& skin_faces,
         const FloatArray& heads, const FloatArray& tails, double ratio) {
        const Points v = points(vertices, "vertices"), s = points(skin, "skin"), h = points(heads, "heads"),
                     t = points(tails, "tails");
        const Triangles f = triangles(faces), g = triangles(skin_faces);
        check_rows(tails, "tails", h.rows());
        return without_gil([&] { return points_on_bones(v, f, s, g, h, t, ratio); });
      },
      "vertices"_a, "triangles"_a, "skin"_a, "skin_triangles"_a, "heads"_a, "tails"_a, "ratio"_a,
      R"(Points (k, 3) along the bones, about as far apart as the cage's vertices, where the cage leaves room for them.

As nodes they tie the flesh to a bone that would else pass between nodes; where there is room, three around the bone
within what it holds (ratio, as for pinned), so that the body cannot spin about it. vertices (C, 3), triangles (D, 3): the cage.
skin (V, 3), skin_triangles (T, 3): the body in it. heads, tails (B, 3): the bones at rest. All metres, in one space.)");
  m.def(
      "pinned",
      [](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces, const FloatArray& heads,
         const FloatArray& tails, double ratio) {
        const Points v = points(vertices, "vertices"), h = points(heads, "heads"), t = points(tails, "tails");
        const Triangles f = triangles(faces);
        check_rows(tails, "tails", h.rows());
        return to_array(without_gil([&] { return pinned(mesh, v, f, h, t, ratio); }));
      },
      "mesh"_a, "vertices"_a, "triangles"_a, "heads"_a, "tails"_a, "ratio"_a,
      R"(Whether the bones hold each node, bool (n,).

A node is held when its distance to the nearest bone is less than `ratio` of the way from bone to skin: 0 holds none, 1
all inside the body. vertices (V, 3), triangles (T, 3): the skin. heads, tails (B, 3): the bones at rest. All metres, in
the mesh's space.)");
}

void bind_thickness(py::module_& m) {
  py::class_<Thickness>(m, "Thickness",
                        R"(How thick a body is: the radius of the largest ball in it that covers a point.

Wide in a belly, narrow in a finger; continuous. Skin that lies inside other skin does not count.)")
      .def(py::init([](const FloatArray& vertices, const IndexArray& faces, const py::object& progress) {
             const Points v = points(vertices, "vertices");
             const Triangles f = triangles(faces);
             const ProgressFn report = with_gil(progress);
             return without_gil([&] { return std::make_unique<Thickness>(v, f, report); });
           }),
           "vertices"_a, "triangles"_a, "progress"_a = py::none(), R"(Of any triangle soup, which is closed first.

vertices (V, 3): metres. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Raises Error as
`closed_surface`.)")
      .def(
          "at",
          [](const Thickness& self, const FloatArray& array) {
            const Points p = points(array, "points");
            const Thickness::Measures found = without_gil([&] { return self.at(p); });
            return std::make_pair(found.thickness, found.depth);
          },
          "points"_a, R"((thickness (k,), depth (k,)) at points (k, 3); metres.

Depth is the distance to the skin, 0 outside of the body; a point there has the thickness of the skin nearest to it.)");
}

void bind_mesh_cut(py::module_& m) {
  py::class_<MeshCut>(m, "MeshCut", R"(Tetrahedra that join skin far apart, as of an arm and the side it hangs at.

Two that share a face are glued when the way through the flesh between their skins is longer than 3 times the straight
distance, and than 4 times their longest edge. Loose parts of the skin, which no way joins, are not.)")
      .def(py::init([](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces) {
             const Points v = points(vertices, "vertices");
             const Triangles f = triangles(faces);
             return without_gil([&] { return std::make_unique<MeshCut>(mesh, v, f); });
           }),
           "mesh"_a, "vertices"_a, "triangles"_a, R"(Finds the glued tetrahedra.

vertices (V, 3): metres. triangles (T, 3): the outward skin in the mesh, open or not. Raises ValueError on wrong shapes
or indices.)")
      .def_property_readonly(
          "glued", [](const MeshCut& self) { return to_array(self.glued()); }, "Which tetrahedra are glued, bool (m,).")
      .def("cut", &MeshCut::cut, py::call_guard<py::gil_scoped_release>(),
           R"(The TetMesh with a crack between glued tetrahedra.

The same tetrahedra; the nodes along the crack are doubled, the doubles at the end.)")
      .def("embed", &MeshCut::embed, "cut"_a, py::call_guard<py::gil_scoped_release>(),
           "The Embedding of the V vertices in the mesh as cut, each in a tetrahedron that belongs to skin near it.");
}

}  // namespace

void bind_mesh(py::module_& m) {
  bind_tet_mesh(m);
  bind_meshers(m);
  bind_body_in_mesh(m);
  bind_mesh_cut(m);
  bind_thickness(m);
}
