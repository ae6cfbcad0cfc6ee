// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/polynomials.hpp"

#include "dynamorph/gram_kernels.hpp"
#include "dynamorph/parallel.hpp"

namespace dynamorph {

namespace {

using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;

/// Sums over the tetrahedra of one target that its tables are made of. Green's strain is quadratic in v,
/// E = sum_k v_k sym(G_k) + sum_kl v_k v_l 1/2 sym(G_k^T G_l), so with the monomials m = (v_k, v_k v_l) each tet adds
/// B^T B to a Gram matrix, B the rows of its strain; columns of pairs hold the coefficient of the full double sum.
class TargetSums {
 public:
  TargetSums(Law law, Eigen::Index r) : law_(law), layout_{r, law != Law::linear}, r_(r), pairs_(layout_.pairs()) {
    const Eigen::Index monomials = law == Law::linear ? r : r + pairs_;
    trace_gram_.setZero(padded(monomials), padded(monomials));
    trace_rows_.setZero(kBatch, monomials);
    if (law != Law::stable_stvk) {
      strain_gram_.setZero(padded(monomials), padded(monomials));
      strain_rows_.setZero(6 * kBatch, monomials);
    } else {
      det_quadratic_.setZero(pairs_);
      det_cubic_.setZero(padded(r), padded(pairs_));
      crosses_.resize(9 * kBatch, pairs_);
      gradients_.resize(9 * kBatch, r);
    }
  }

  /// G (9, r): column k is dF/dz_k, column-major 3 x 3.
  void add(double volume, const RowMajor& G) {
    const double root = std::sqrt(volume);
    trace_rows_.row(filled_).head(r_) = root / std::sqrt(2.0) * (G.row(0) + G.row(4) + G.row(8));
    if (law_ != Law::stable_stvk) {
      // sqrt(2) on the shear entries, so that the dot product of two rows of six is A:B of symmetric A and B.
      const double shear = root * std::sqrt(0.5);
      for (int a = 0; a < 3; ++a) {
        const int b = (a + 1) % 3;
        strain_rows_.row(6 * filled_ + a).head(r_) = root * G.row(4 * a);
        strain_rows_.row(6 * filled_ + 3 + a).head(r_) = shear * (G.row(3 * a + b) + G.row(3 * b + a));
      }
    }
    if (law_ != Law::linear) add_pairs(volume, G);
    if (law_ == Law::stable_stvk) gradients_.middleRows(9 * filled_, 9) = G;
    if (++filled_ == kBatch) flush();
  }

  void tables(VectorXd& lambda, VectorXd& mu) {
    flush();
    lambda = table(trace_gram_);
    if (law_ != Law::stable_stvk) {
      mu = table(strain_gram_);
      return;
    }
    mu = lambda;  // 1/2 mu tr(E)^2, and mu (tr E - det F + 1)
    mu.head(pairs_) += det_quadratic_;
    Eigen::Map<RowMajor>(mu.data() + layout_.linear(), r_, pairs_) -= det_cubic_.topLeftCorner(r_, pairs_);
  }

 private:
  static constexpr Eigen::Index kBatch = 32;

  void add_pairs(double volume, const RowMajor& G) {
    const double half = 0.5 * std::sqrt(volume);
    const bool stable = law_ == Law::stable_stvk;
    for (Eigen::Index k = 0, p = 0; k < r_; p += r_ - k, ++k) {
      double* trace = trace_rows_.row(filled_).data() + r_ + p;
      const Eigen::Index count = r_ - k;
      double* strain = stable ? nullptr : strain_rows_.row(6 * filled_).data() + r_ + p;
      strain_of_pairs(G.data(), r_, k, trace, strain, strain_rows_.cols());
      Eigen::Map<Eigen::RowVectorXd> products(trace, count);
      if (stable) {
        crosses_of_pairs(G.data(), r_, k, crosses_.row(9 * filled_).data() + p, pairs_);
        // tr E - det F + 1 to second order: 1/2 G:G - 1/2 ((tr G)^2 - G : G^T), and the latter is half the cross
        // product's trace.
        const auto cross = [&](int c) { return crosses_.row(9 * filled_ + c).segment(p, count); };
        det_quadratic_.segment(p, count) += (volume * (products - cross(0) - cross(4) - cross(8))).transpose();
        crosses_.block(9 * filled_, p, 9, count) *= volume;
      } else {
        strain_rows_.block(6 * filled_, r_ + p, 6, count) *= half;
      }
      products *= half / std::sqrt(2.0);
    }
  }

  void flush() {
    if (filled_ == 0) return;
    const Eigen::Index monomials = trace_rows_.cols();
    add_transposed_product(trace_rows_.data(), monomials, trace_rows_.data(), monomials, filled_, true,
                           trace_gram_.data());
    if (law_ != Law::stable_stvk)
      add_transposed_product(strain_rows_.data(), monomials, strain_rows_.data(), monomials, 6 * filled_, true,
                             strain_gram_.data());
    else
      add_transposed_product(gradients_.data(), r_, crosses_.data(), pairs_, 9 * filled_, false, det_cubic_.data());
    filled_ = 0;
  }

  /// Differentiates E = m^T gram m twice, symmetrised over all indices.
  VectorXd table(const RowMajor& upper) const {
    const MatrixXd g = MatrixXd(upper).selfadjointView<Eigen::Upper>();
    VectorXd out(layout_.size());
    const auto pair = [&](Eigen::Index k, Eigen::Index l) { return r_ + pair_index(r_, k, l); };
    const auto for_pairs = [&](const auto& visit) {
      for (Eigen::Index k = 0, p = 0; k < r_; ++k)
        for (Eigen::Index l = k; l < r_; ++l, ++p) visit(p, k, l);
    };
    for_pairs([&](Eigen::Index p, Eigen::Index k, Eigen::Index l) { out(p) = 2 * g(k, l); });
    if (law_ == Law::linear) return out;
    for_pairs([&](Eigen::Index p, Eigen::Index k, Eigen::Index l) {
      for (Eigen::Index m = 0; m < r_; ++m)
        out(layout_.linear() + m * pairs_ + p) = 4 * (g(k, pair(l, m)) + g(l, pair(k, m)) + g(m, pair(k, l)));
    });
    Eigen::Index at = layout_.quadratic();
    for_pairs([&](Eigen::Index q, Eigen::Index m, Eigen::Index n) {
      for_pairs([&](Eigen::Index p, Eigen::Index k, Eigen::Index l) {
        if (p >= q) out(at++) = 4 * (g(pair(k, l), pair(m, n)) + g(pair(k, m), pair(l, n)) + g(pair(k, n), pair(l, m)));
      });
    });
    return out;
  }

  Law law_;
  TableLayout layout_;
  Eigen::Index r_, pairs_, filled_ = 0;
  RowMajor trace_gram_, strain_gram_, trace_rows_, strain_rows_;
  VectorXd det_quadratic_;                    ///< packed pairs
  RowMajor det_cubic_, crosses_, gradients_;  ///< (r, pairs) padded, (9 batch, pairs), (9 batch, r)
};

}  // namespace

ReducedTables reduce(const FullModel& model, const MatrixXd& U, const ProgressFn& progress) {
  const SoftBody& body = model.body();
  if (U.rows() != model.dofs())
    throw std::invalid_argument("U: expected " + std::to_string(model.dofs()) + " rows, got " +
                                std::to_string(U.rows()));
  if (!U.allFinite()) throw std::invalid_argument("U: must be finite");
  ReducedTables tables;
  tables.law = model.law();
  tables.basis = U;
  const int targets = int(model.targets().size());
  const Eigen::Index tets = body.mesh.tets.rows();
  const RowMajor modes = U;  // a node's rows in one piece
  tables.lambda.resize(targets);
  tables.mu.resize(targets);
  in_parallel(targets, progress, [&](int j, const ProgressFn& done) {
    TargetSums sums(model.law(), U.cols());
    RowMajor G(9, U.cols());
    for (Eigen::Index e = 0; e < tets; ++e) {
      if (e % 512 == 0) report(done, double(e) / tets);
      const Element& element = model.shape(j).elements[e];
      if (element.volume == 0) continue;  // a tet outside this target's region
      G.setZero();
      for (int a = 0; a < 4; ++a) {
        const int i = body.free_of_node[body.mesh.tets(e, a)];
        for (int c = 0; i >= 0 && c < 3; ++c)
          G.middleRows<3>(3 * c) += element.gradients(c, a) * modes.middleRows<3>(3 * i);
      }
      sums.add(element.volume, G);
    }
    sums.tables(tables.lambda[j], tables.mu[j]);
  });
  report(progress, 1);
  return tables;
}

}  // namespace dynamorph
