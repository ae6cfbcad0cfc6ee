// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/simd/dispatch.hpp"

#include <cstdlib>
#include <string>

#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

#if defined(DYNAMORPH_X86_64)
constexpr InstructionSet kSets[] = {InstructionSet::avx512, InstructionSet::avx2, InstructionSet::baseline};
constexpr const char* kNames = "baseline, avx2 or avx512";

/// Checks for the features that CMakeLists.txt compiles for. The system must save the wide registers too; the
/// compiler's functions check that as well.
bool is_supported(InstructionSet set) {
  if (set == InstructionSet::baseline) return true;
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                    __builtin_cpu_supports("bmi2");
  if (set == InstructionSet::avx2) return avx2;
  return avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512cd") &&
         __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
}
#else
constexpr InstructionSet kSets[] = {InstructionSet::baseline};
constexpr const char* kNames = "baseline, the only one on this kind of processor";

bool is_supported(InstructionSet) { return true; }
#endif

}  // namespace

const char* name_of(InstructionSet set) {
#if defined(DYNAMORPH_X86_64)
  if (set == InstructionSet::avx512) return "avx512";
  if (set == InstructionSet::avx2) return "avx2";
#endif
  (void)set;
  return "baseline";
}

InstructionSet choose_instruction_set() {
  const char* wanted = std::getenv("DYNAMORPH_ISA");
  for (InstructionSet set : kSets) {
    if (wanted == nullptr || *wanted == 0) {
      if (is_supported(set)) return set;
    } else if (std::string(wanted) == name_of(set)) {
      if (is_supported(set)) return set;
      throw Error(std::string("DYNAMORPH_ISA: this processor does not have ") + wanted +
                  ". Name one that it has, or unset the variable.");
    }
  }
  throw std::invalid_argument(std::string("DYNAMORPH_ISA: expected ") + kNames + ", got '" + wanted + "'");
}

}  // namespace dynamorph
