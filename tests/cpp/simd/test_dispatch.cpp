// SPDX-License-Identifier: GPL-3.0-or-later
// Which instruction set is chosen. That all of them compute the same, tests/engine/test_instruction_sets.py shows.
#include <doctest/doctest.h>

#include <cstdlib>
#include <string>

#include "dynamorph/core/errors.hpp"
#include "dynamorph/simd/dispatch.hpp"

using namespace dynamorph;

namespace {

/// DYNAMORPH_ISA while this lives.
class Wanted {
 public:
  explicit Wanted(const char* word) {
    const char* before = std::getenv("DYNAMORPH_ISA");
    if (before != nullptr) before_ = before;
    set(word);
  }
  ~Wanted() { set(before_.empty() ? nullptr : before_.c_str()); }

 private:
  static void set(const char* word) {
#ifdef _WIN32
    _putenv_s("DYNAMORPH_ISA", word != nullptr ? word : "");
#else
    word != nullptr ? setenv("DYNAMORPH_ISA", word, 1) : unsetenv("DYNAMORPH_ISA");
#endif
  }

  std::string before_;
};

}  // namespace

TEST_CASE("the instruction set is the one that DYNAMORPH_ISA names, else the best") {
  if (const char* word = std::getenv("DYNAMORPH_ISA")) CHECK(name_of(instruction_set()) == std::string(word));
  const Wanted none(nullptr);
  const InstructionSet best = choose_instruction_set();
  {
    const Wanted empty("");
    CHECK(choose_instruction_set() == best);
  }
  {
    const Wanted same(name_of(best));
    CHECK(choose_instruction_set() == best);
  }
  const Wanted lowest("baseline");
  CHECK(choose_instruction_set() == InstructionSet::baseline);
}

TEST_CASE("an instruction set that is none, or that the processor lacks, is an error that says so") {
  const Wanted typo("AVX2");
  CHECK_THROWS_AS(choose_instruction_set(), std::invalid_argument);
#if defined(DYNAMORPH_X86_64)
  std::string best;
  {
    const Wanted none(nullptr);
    best = name_of(choose_instruction_set());
  }
  for (const char* word : {"avx2", "avx512"}) {
    const Wanted wanted(word);
    if (best == "baseline" || (best == "avx2" && std::string(word) == "avx512"))
      CHECK_THROWS_AS(choose_instruction_set(), Error);
    else
      CHECK(name_of(choose_instruction_set()) == std::string(word));
  }
#else
  const Wanted other("avx2");
  CHECK_THROWS_AS(choose_instruction_set(), std::invalid_argument);
#endif
}
