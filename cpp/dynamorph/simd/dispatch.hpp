// SPDX-License-Identifier: GPL-3.0-or-later
// Kernels, the loops that matter, are compiled once for each instruction set, and the processor chooses when the first
// one is called, so that a wheel built for any x86-64 uses AVX2 or AVX-512 where the machine has it. What one computes
// depends on the instruction set in the last digits (fused multiply-adds, sums by lanes), and on nothing else.
//
// CMakeLists.txt compiles every file *_kernels.cpp several times, with DYNAMORPH_ISA the namespace that its functions
// are put into. Such a file takes and gives pointers and sizes, and includes neither Eigen nor what the standard
// library defines inline: the linker keeps one copy of an inline function, which may be the one for AVX-512.
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

/// The best that the processor has, or what the environment variable DYNAMORPH_ISA names. Throws std::invalid_argument
/// when that is no name, Error when the processor does not have it.
InstructionSet choose_instruction_set();

/// The one in use: chosen once.
inline InstructionSet instruction_set() {
  static const InstructionSet chosen = choose_instruction_set();
  return chosen;
}

/// A function for each instruction set, called as one.
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
