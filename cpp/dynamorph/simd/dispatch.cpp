// SPDX-License-Identifier: GPL-3.0-or-later
#include "dynamorph/simd/dispatch.hpp"

#if defined(DYNAMORPH_X86_64)
#include <cpuid.h>
#endif

#include <cstdlib>
#include <string>

#include "dynamorph/core/errors.hpp"

namespace dynamorph {

namespace {

#if defined(DYNAMORPH_X86_64)
constexpr InstructionSet kSets[] = {InstructionSet::avx512, InstructionSet::avx2, InstructionSet::baseline};
constexpr const char* kNames = "baseline, avx2 or avx512";

/// Registers whose contents the system saves, as bits of XCR0. Only where CPUID says that there is such a register.
unsigned saved_registers() {
  unsigned low, high;
  __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
  return low;
}

/// Asks the processor for the features that CMakeLists.txt compiles for, and the system for their registers. Not
/// __builtin_cpu_supports, which depends on what the compiler is linked with: zig's says that there are none.
bool is_supported(InstructionSet set) {
  if (set == InstructionSet::baseline) return true;
  const auto has = [](unsigned found, unsigned wanted) { return (found & wanted) == wanted; };
  constexpr unsigned kFma = 1u << 12, kXsave = 1u << 27, kAvx = 1u << 28;                            // leaf 1, ECX
  constexpr unsigned kBmi = 1u << 3, kAvx2 = 1u << 5, kBmi2 = 1u << 8;                               // leaf 7, EBX
  constexpr unsigned kF = 1u << 16, kDq = 1u << 17, kCd = 1u << 28, kBw = 1u << 30, kVl = 1u << 31;  // leaf 7, EBX
  constexpr unsigned kWide = 0x06, kWider = 0xe6;                                                    // XCR0
  unsigned eax, ebx, ecx, edx;
  if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx) || !has(ecx, kFma | kXsave | kAvx)) return false;
  if (!__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) || !has(ebx, kBmi | kAvx2 | kBmi2)) return false;
  if (set == InstructionSet::avx2) return has(saved_registers(), kWide);
  return has(ebx, kF | kDq | kCd | kBw | kVl) && has(saved_registers(), kWider);
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
