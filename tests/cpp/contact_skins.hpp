// SPDX-License-Identifier: GPL-3.0-or-later
// The skin of the bodies of scenes.hpp, as what can touch something.
#pragma once

#include "dynamorph/contact/contact_samples.hpp"
#include "dynamorph/mesh/embedding.hpp"
#include "scenes.hpp"

namespace scenes {

using namespace dynamorph;

/// The surface nodes of a body, with the normals of its surface. Pinned nodes follow the first bone.
inline ContactSkin contact_skin_of(const SoftBody& body, double thickness) {
  Points normals = Points::Zero(body.mesh.nodes.rows(), 3);
  const Triangles faces = surface_of(body.mesh);
  for (Eigen::Index t = 0; t < faces.rows(); ++t) {
    const Vector3d a = body.mesh.nodes.row(faces(t, 0)), b = body.mesh.nodes.row(faces(t, 1)),
                   c = body.mesh.nodes.row(faces(t, 2));
    for (int k = 0; k < 3; ++k) normals.row(faces(t, k)) += (b - a).cross(c - a);
  }
  std::vector<int> nodes;
  for (int i = 0; i < int(normals.rows()); ++i)
    if (!normals.row(i).isZero(1e-12)) nodes.push_back(i);
  ContactSkin out;
  out.skin.rest = body.mesh.nodes(nodes, Eigen::all);
  out.skin.embedding = embed(body.mesh, out.skin.rest);
  MatrixXd weights = MatrixXd::Zero(Eigen::Index(nodes.size()), body.skin.cols());
  for (Eigen::Index p = 0; p < weights.rows(); ++p)
    if (const int free = body.free_of_node[std::size_t(nodes[std::size_t(p)])]; free >= 0)
      weights.row(p) = body.skin.row(free);
    else
      weights(p, 0) = 1;
  out.skin.weights = normalized(weights);
  out.points = SurfacePoints::vertices(weights.rows());
  out.normals = normals(nodes, Eigen::all);
  out.thickness = VectorXd::Constant(weights.rows(), thickness);
  return out;
}

/// The same with the middle of each face of the body's surface, after the surface's nodes.
inline ContactSkin contact_faces_of(const SoftBody& body, double thickness) {
  ContactSkin out = contact_skin_of(body, thickness);
  const Triangles faces = surface_of(body.mesh);
  const Eigen::Index vertices = out.points.size(), all = vertices + faces.rows();
  out.points.corners.conservativeResize(all, 3);
  out.points.weights.conservativeResize(all, 3);
  out.normals.conservativeResize(all, 3);
  out.thickness = VectorXd::Constant(all, thickness);
  for (Eigen::Index t = 0; t < faces.rows(); ++t) {
    Vector3d normal = Vector3d::Zero();
    for (int k = 0; k < 3; ++k)
      for (int v = 0; v < int(vertices); ++v)
        if (out.skin.rest.row(v) == body.mesh.nodes.row(faces(t, k))) {
          out.points.corners(vertices + t, k) = v;
          normal += out.normals.row(v).normalized();
        }
    out.points.weights.row(vertices + t).setConstant(1.0 / 3);
    out.normals.row(vertices + t) = normal;
  }
  return out;
}

}  // namespace scenes
