// SPDX-License-Identifier: GPL-3.0-or-later
#include "arrays.hpp"
#include "bindings.hpp"
#include "dynamorph/core/progress.hpp"
#include "dynamorph/mesh/cage.hpp"
#include "dynamorph/mesh/closed_surface.hpp"
#include "dynamorph/mesh/deformation.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "dynamorph/mesh/fill.hpp"
#include "dynamorph/mesh/mesh_cut.hpp"
#include "dynamorph/mesh/pins.hpp"
#include "dynamorph/mesh/symmetry.hpp"
#include "dynamorph/mesh/tet_mesh.hpp"
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
  py::class_<TetMesh>(m, "TetMesh", "A mesh of m tetrahedra and n nodes.")
      .def(py::init([](const FloatArray& nodes, const IndexArray& tets) {
             return make_tet_mesh(points(nodes, "nodes"), to_indices<Tets>(tets, "tets"));
           }),
           "nodes"_a, "tets"_a, R"(Makes a mesh from stored arrays.

nodes (n, 3): rest positions, meters. tets (m, 4): node indices. Raises ValueError when an index is out of range, a
coordinate is NaN, a tet is flat or inside out, or a node belongs to no tet.)")
      .def_readonly("nodes", &TetMesh::nodes, "Rest positions (n, 3), meters.")
      .def_readonly("tets", &TetMesh::tets, "Node indices (m, 4), positively oriented.")
      .def_property_readonly("volumes", &volumes, "Volumes (m,), cubic meters.");

  py::class_<Embedding>(m, "Embedding", "Where V surface points lie in a TetMesh.")
      .def(py::init([](const IndexArray& array, const decltype(Embedding::weights)& weights) {
             const Tets nodes = to_indices<Tets>(array, "nodes");
             if (nodes.rows() != weights.rows() || (nodes.size() > 0 && nodes.minCoeff() < 0))
               throw std::invalid_argument("nodes, weights: expected one row per point and no negative node");
             return Embedding{nodes, weights, VectorXd::Zero(nodes.rows())};
           }),
           "nodes"_a, "weights"_a,
           "Restores an embedding from its nodes and weights (V, 4). Its distances are not known and read as 0.")
      .def_readonly("nodes", &Embedding::nodes, "The nodes (V, 4) that carry each point, all of one tet.")
      .def_readonly("weights", &Embedding::weights,
                    "Their weights (V, 4). Rows sum to 1; only points outside have negatives.")
      .def_readonly("distances", &Embedding::distances, "Distances (V,) to the mesh, meters; 0 inside.")
      .def(
          "interpolate",
          [](const Embedding& self, const FloatArray& values) {
            const auto matrix = to_matrix<RowMajor>(values, "values");
            if (self.nodes.size() && self.nodes.maxCoeff() >= matrix.rows())
              throw std::invalid_argument("values: expected one row per node, got shape " + shape_of(values));
            check_finite("values", matrix);
            return without_gil([&] { return self.interpolate(matrix); });
          },
          "values"_a, "Interpolates values (n, k) at the nodes to values (V, k) at the points.");
}

void check_ratio(double ratio) {
  if (!(ratio >= 0 && ratio <= 1))
    throw std::invalid_argument("ratio: expected a number from 0 to 1, got " + std::to_string(ratio));
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
      "vertices"_a, "triangles"_a, R"(Turns any triangle soup into a closed surface with outward faces.

vertices (V, 3): meters. triangles (T, 3): vertex indices. Vertices at the same place are welded, duplicate faces are
dropped, faces are turned outward, and holes are capped. Returns the vertices (W, 3), the triangles (U, 3) with the caps
last, and the counts of defects by name. Raises Error when the input is empty, flat, not finite, or not between 1e-6 and
1e6 m across.)");
  m.def(
      "make_cage_surface",
      [](const FloatArray& vertices, const IndexArray& faces, int target_vertices, const py::object& progress) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        const ProgressFn report = with_gil(progress);
        CageSurface cage = without_gil([&] { return make_cage_surface(v, f, target_vertices, report); });
        return std::make_pair(std::move(cage.vertices), std::move(cage.triangles));
      },
      "vertices"_a, "triangles"_a, "target_vertices"_a, "progress"_a = py::none(),
      R"(Wraps a closed cage of about `target_vertices` vertices around any triangle soup.

vertices (V, 3): meters. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Returns
vertices (C, 3) and outward triangles (D, 3). Raises Error when the input is empty, flat, not finite, or not between 1e-6
and 1e6 m across.)");
}

void bind_body_in_mesh(py::module_& m) {
  m.def(
      "symmetric_like",
      [](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        check_finite("vertices", v);
        return without_gil([&] { return symmetric_like(mesh, v, f); });
      },
      "mesh"_a, "vertices"_a, "triangles"_a, R"(Returns a mirror-symmetric mesh for a mirror-symmetric skin.

Half of the mesh and its mirror image, whose nodes and tets come last, if the mirror image of the skin about the middle
of one of its axes, X first, is nowhere farther from it than 1/500 of its diagonal. The same mesh otherwise. vertices
(V, 3): meters. triangles (T, 3): vertex indices.)");
  m.def(
      "embed",
      [](const TetMesh& mesh, const FloatArray& array) {
        const Points p = points(array, "points");
        return without_gil([&] { return embed(mesh, p); });
      },
      "mesh"_a, "points"_a, R"(Embeds surface points (V, 3), meters, by barycentric weights.

A point outside the mesh uses the nearest tet. Its weights are extrapolated, but not below -1/2.)");
  m.def(
      "fill_fractions",
      [](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces, const py::object& progress) {
        const Points v = points(vertices, "vertices");
        const Triangles f = triangles(faces);
        const ProgressFn report = with_gil(progress);
        return without_gil([&] { return fill_fractions(mesh, v, f, report); });
      },
      "mesh"_a, "vertices"_a, "triangles"_a, "progress"_a = py::none(),
      R"(Fraction (m,) of each tet that the body fills, 0.05 .. 1.

The body may be any triangle soup; it is closed first. vertices (V, 3): meters. triangles (T, 3): vertex indices.
progress: called with 0..1, returns False to cancel.)");
  m.def(
      "extend_to_nodes",
      [](const TetMesh& mesh, const Embedding& embedding, const FloatArray& values) {
        const MatrixXd v = to_matrix<RowMajor>(values, "values");
        check_rows(values, "values", embedding.nodes.rows());
        check_finite("values", v);
        if (embedding.nodes.size() > 0 && embedding.nodes.maxCoeff() >= mesh.nodes.rows())
          throw std::invalid_argument("embedding: it belongs to another mesh");
        return without_gil([&] { return RowMajor(extend_to_nodes(mesh, embedding, v)); });
      },
      "mesh"_a, "embedding"_a, "values"_a,
      R"(Extends values (V, k) at the embedded points to values (n, k) at the nodes.

The fit is least squares at the points and smooth inside. Constants stay constant. Values overshoot slightly, so clamp
and normalize skin weights afterward.)");
  m.def(
      "points_on_bones",
      [](const FloatArray& vertices, const IndexArray& faces, const FloatArray& skin, const IndexArray& skin_faces,
         const FloatArray& heads, const FloatArray& tails, double ratio) {
        const Points v = points(vertices, "vertices"), s = points(skin, "skin"), h = points(heads, "heads"),
                     t = points(tails, "tails");
        const Triangles f = triangles(faces), g = triangles(skin_faces);
        check_rows(tails, "tails", h.rows());
        check_finite("vertices", v);
        check_finite("skin", s);
        check_ratio(ratio);
        return without_gil([&] { return points_on_bones(v, f, s, g, h, t, ratio); });
      },
      "vertices"_a, "triangles"_a, "skin"_a, "skin_triangles"_a, "heads"_a, "tails"_a, "ratio"_a,
      R"(Points (k, 3) along the bones, about as far apart as the cage's vertices, where the cage leaves room for them.

As nodes, they tie the soft tissue to a bone that would otherwise pass between nodes. Where there is room, three points
surround the bone within the range that it pins (`ratio`, as for `pinned`), so that the body cannot spin about the bone.
vertices (C, 3), triangles (D, 3): the cage. skin (V, 3), skin_triangles (T, 3): the body in it. heads, tails (B, 3):
the bones at rest. All are in meters and in one space.)");
  m.def(
      "pinned",
      [](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces, const FloatArray& heads,
         const FloatArray& tails, double ratio) {
        const Points v = points(vertices, "vertices"), h = points(heads, "heads"), t = points(tails, "tails");
        const Triangles f = triangles(faces);
        check_rows(tails, "tails", h.rows());
        check_ratio(ratio);
        return to_array(without_gil([&] { return pinned(mesh, v, f, h, t, ratio); }));
      },
      "mesh"_a, "vertices"_a, "triangles"_a, "heads"_a, "tails"_a, "ratio"_a,
      R"(Whether the bones pin each node, bool (n,).

A node is pinned when its distance to the nearest bone is less than `ratio` of the way from bone to skin: 0 pins none, 1
pins all nodes inside the body. vertices (V, 3), triangles (T, 3): the skin. heads, tails (B, 3): the bones at rest. All
are in meters and in the mesh's space.)");
}

void bind_thickness(py::module_& m) {
  py::class_<Thickness>(m, "Thickness",
                        R"(How thick a body is: the radius of the largest ball inside it that covers a point.

Thickness is large in a belly and small in a finger, and it is continuous. Skin inside other skin does not count.)")
      .def(py::init([](const FloatArray& vertices, const IndexArray& faces, const py::object& progress) {
             const Points v = points(vertices, "vertices");
             const Triangles f = triangles(faces);
             const ProgressFn report = with_gil(progress);
             return without_gil([&] { return std::make_unique<Thickness>(v, f, report); });
           }),
           "vertices"_a, "triangles"_a, "progress"_a = py::none(), R"(Measures any triangle soup, which is closed first.

vertices (V, 3): meters. triangles (T, 3): vertex indices. progress: called with 0..1, returns False to cancel. Raises
Error like `closed_surface`.)")
      .def(
          "at",
          [](const Thickness& self, const FloatArray& array) {
            const Points p = points(array, "points");
            check_finite("points", p);
            const Thickness::Measures found = without_gil([&] { return self.at(p); });
            return std::make_pair(found.thickness, found.depth);
          },
          "points"_a, R"(Returns (thickness (k,), depth (k,)) at points (k, 3), all in meters.

Depth is the distance to the skin, 0 outside the body. A point outside has the thickness of the skin nearest to it.)")
      .def(
          "covering",
          [](const Thickness& self, const FloatArray& array, double tolerance) {
            const Points p = points(array, "points");
            check_finite("points", p);
            if (!(tolerance >= 0)) throw std::invalid_argument("tolerance: must not be negative");
            const std::vector<Thickness::Ball> balls = without_gil([&] { return self.covering(p, tolerance); });
            Points centers(Eigen::Index(balls.size()), 3);
            VectorXd radii(centers.rows());
            for (std::size_t k = 0; k < balls.size(); ++k) {
              centers.row(Eigen::Index(k)) = balls[k].center;
              radii(Eigen::Index(k)) = balls[k].radius;
            }
            return std::make_pair(centers, radii);
          },
          "points"_a, "tolerance"_a, R"(Returns (centers (K, 3), radii (K,)) of few balls that fill the body, meters.

They come as near to each of the points (k, 3) of the skin as tolerance times the thickness there, or as near as any
ball in the body does.)");
}

void bind_mesh_cut(py::module_& m) {
  py::class_<MeshCut>(m, "MeshCut",
                      R"(Cuts apart tetrahedra that join distant parts of the skin, such as arm and torso.

Two tetrahedra that share a face are glued when the path through the body between their skins is longer than 3 times the
straight distance and longer than 4 times their longest edge. Loose parts of the skin, which no path joins, are not
glued.)")
      .def(py::init([](const TetMesh& mesh, const FloatArray& vertices, const IndexArray& faces) {
             const Points v = points(vertices, "vertices");
             const Triangles f = triangles(faces);
             return without_gil([&] { return std::make_unique<MeshCut>(mesh, v, f); });
           }),
           "mesh"_a, "vertices"_a, "triangles"_a, R"(Finds the glued tetrahedra.

vertices (V, 3): meters. triangles (T, 3): the outward-facing skin in the mesh, open or closed. Raises ValueError on
wrong shapes or indices, and on skin far larger than the mesh.)")
      .def_property_readonly(
          "glued", [](const MeshCut& self) { return to_array(self.glued()); }, "Which tetrahedra are glued, bool (m,).")
      .def("cut", &MeshCut::cut, py::call_guard<py::gil_scoped_release>(),
           R"(Returns the TetMesh with a crack between glued tetrahedra.

The tetrahedra stay the same. Nodes along the crack are duplicated, and the duplicates come last.)")
      .def("embed", &MeshCut::embed, "cut"_a, py::call_guard<py::gil_scoped_release>(),
           "Embeds the V vertices in the cut mesh, each in a tetrahedron that belongs to skin near it.");
}

void bind_deformation(py::module_& m) {
  py::class_<Deformation>(m, "Deformation", "What displacements do to a skin in each of F frames.")
      .def_readonly("largest", &Deformation::largest, "The largest displacement of a vertex (F,), meters.")
      .def_readonly("percentile", &Deformation::percentile, "The 99.9th percentile of displacement (F,), meters.")
      .def_readonly("shortest", &Deformation::shortest,
                    "The 0.1th percentile of the edges' lengths over those at rest (F,), in the mesh where it is "
                    "lowest; 1 without edges.")
      .def_readonly("longest", &Deformation::longest,
                    "Their 99.9th percentile (F,), in the mesh where it is highest; 1 without edges.")
      .def_readonly("flipped", &Deformation::flipped,
                    "The share of the skin's area that is turned by more than 90 degrees (F,).")
      .def_readonly("farthest", &Deformation::farthest,
                    "The largest displacement of each vertex (V,) in all frames, meters.");
  m.def(
      "measure_deformation",
      [](const FloatArray& rest, const IndexArray& faces, const std::vector<IndexArray>& edges,
         const FloatArray& coordinates, const FloatArray& modes, const py::object& progress) {
        const Points x = points(rest, "rest");
        const Triangles f = triangles(faces);
        check_finite("rest", x);
        std::vector<EdgeEnds> ends;
        for (const IndexArray& each : edges) ends.push_back(to_indices<EdgeEnds>(each, "edges"));
        const auto q = to_matrix<RowMajor>(coordinates, "coordinates");
        check_shape("modes", modes, {q.cols(), x.rows(), 3});
        const Eigen::Map<const RowMajor> shapes(modes.data(), q.cols(), x.size());  // large, so not copied
        const ProgressFn report = with_gil(progress);
        return without_gil([&] { return measure_deformation(x, f, ends, q, shapes, report); });
      },
      "rest"_a, "triangles"_a, "edges"_a, "coordinates"_a, "modes"_a, "progress"_a = py::none(),
      R"(Measures how far displacements move a skin, and how much they stretch it and turn it over.

rest (V, 3): the skin, meters. triangles (T, 3): vertex indices. edges: an array (E, 2) of vertex indices for each mesh
of the skin, because a small mesh that is torn is visible too. The displacements in F frames are coordinates (F, r) times
modes (r, V, 3), meters; only a few frames are in memory at a time. To measure displacements (k, V, 3) themselves, pass
them as modes with an identity matrix as coordinates. progress: called with 0..1, returns False to cancel.

A quantile of displacement counts vertices by the area around them, one of stretch counts edges by their length at rest:
it is the smallest value up to which there is that share of all area or length. Vertices around which no triangle has an
area count in `farthest` alone. Raises ValueError on wrong shapes or indices, edges without a length, and numbers that
are not finite.)");
}

}  // namespace

void bind_mesh(py::module_& m) {
  bind_tet_mesh(m);
  bind_meshers(m);
  bind_body_in_mesh(m);
  bind_mesh_cut(m);
  bind_thickness(m);
  bind_deformation(m);
}
