// SPDX-License-Identifier: GPL-3.0-or-later
// Kernels are the loops that matter. They are compiled once for each instruction set, and the processor decides which
// to use when the first one is called. So a wheel built for any x86-64 uses AVX2 or AVX-512 where the machine has it.
// The results depend on the instruction set in their last digits (fused multiply-adds, sums by lanes), and on nothing
// else.
//
// CMakeLists.txt compiles every file *_kernels.cpp several times; DYNAMORPH_ISA is the namespace of its functions. The
// functions of such a file take and return pointers and sizes. The file must include neither Eigen nor anything that
// the standard library defines inline, because the linker keeps one copy of an inline function, which may be the one
// for AVX-512.
#pragma once

#if !defined(DYNAMORPH_ISA)

namespace dynamorph {

#if defined(__x86_64__) || defined(_M_X64)
#define DYNAMORPH_X86_64
enum class InstructionSet { baseline, avx2, avx512 };
#else
enum class InstructionSet { baseline };
#endif

/// "baseline", "avx2" or "avx512".
const char* name_of(InstructionSet set);

/// The best one that the processor has, or the one that the environment variable DYNAMORPH_ISA names. Throws
/// std::invalid_argument when the name is unknown, and Error when the processor does not have it.
InstructionSet choose_instruction_set();

/// The instruction set in use, which is chosen once.
inline InstructionSet instruction_set() {
  static const InstructionSet chosen = choose_instruction_set();
  return chosen;
}

/// One function for each instruction set, called like a single function.
template <class Function>
struct Dispatched;
template <class Result, class... Arguments>
struct Dispatched<Result(Arguments...)> {
#if defined(DYNAMORPH_X86_64)
  Result (*of_set[3])(Arguments...);
#else
  Result (*of_set[1])(Arguments...);
#endif
  Result operator()(Arguments... arguments) const { return of_set[int(instruction_set())](arguments...); }
};

}  // namespace dynamorph

#endif

#define DYNAMORPH_KERNEL_IN(set, result, name, ...) \
  namespace set {                                   \
  result name(__VA_ARGS__);                         \
  }

/// Declares a kernel, in namespace dynamorph: DYNAMORPH_KERNEL(result, name, parameters...).
#if defined(DYNAMORPH_ISA)
#define DYNAMORPH_KERNEL(result, name, ...) DYNAMORPH_KERNEL_IN(DYNAMORPH_ISA, result, name, __VA_ARGS__)
#elif defined(DYNAMORPH_X86_64)
#define DYNAMORPH_KERNEL(result, name, ...)                \
  DYNAMORPH_KERNEL_IN(baseline, result, name, __VA_ARGS__) \
  DYNAMORPH_KERNEL_IN(avx2, result, name, __VA_ARGS__)     \
  DYNAMORPH_KERNEL_IN(avx512, result, name, __VA_ARGS__)   \
  inline constexpr Dispatched<result(__VA_ARGS__)> name = {{baseline::name, avx2::name, avx512::name}}
#else
#define DYNAMORPH_KERNEL(result, name, ...)                \
  DYNAMORPH_KERNEL_IN(baseline, result, name, __VA_ARGS__) \
  inline constexpr Dispatched<result(__VA_ARGS__)> name = {{baseline::name}}
#endif
