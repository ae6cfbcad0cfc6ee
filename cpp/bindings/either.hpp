// SPDX-License-Identifier: GPL-3.0-or-later
// One Python class for what exists for both kinds of model.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "bindings.hpp"
#include "dynamorph/models/full_model.hpp"
#include "dynamorph/reduced/reduced_model.hpp"

namespace dynamorph {

using EitherModel = std::variant<std::shared_ptr<FullModel>, std::shared_ptr<ReducedModel>>;

/// A T<FullModel> or a T<ReducedModel>, shared.
template <template <class> class T>
class Either {
 public:
  template <class Model>
  explicit Either(std::shared_ptr<T<Model>> of) : of_(std::move(of)) {}

  /// f(T<Model>&).
  template <class F>
  decltype(auto) visit(F&& f) const {
    return std::visit([&](const auto& of) -> decltype(auto) { return f(*of); }, of_);
  }
  /// f(std::shared_ptr<T<Model>>).
  template <class F>
  decltype(auto) visit_shared(F&& f) const {
    return std::visit(std::forward<F>(f), of_);
  }

  /// That of such a model. Throws std::invalid_argument where it is of the other kind; name: what it is to be.
  template <class Model>
  std::shared_ptr<T<Model>> of(const char* name) const {
    if (const auto* found = std::get_if<std::shared_ptr<T<Model>>>(&of_)) return *found;
    throw std::invalid_argument(std::string(name) + ": it belongs to another model");
  }

 private:
  std::variant<std::shared_ptr<T<FullModel>>, std::shared_ptr<T<ReducedModel>>> of_;
};

/// The same; null for none.
template <class Model, template <class> class T>
std::shared_ptr<T<Model>> of_kind(const std::optional<Either<T>>& either, const char* name) {
  return either ? either->template of<Model>(name) : nullptr;
}

/// Makes one by f(model).
template <template <class> class T, class F>
Either<T> make_either(const EitherModel& model, F&& f) {
  return std::visit([&](const auto& of_kind) { return Either<T>(f(of_kind)); }, model);
}

}  // namespace dynamorph
