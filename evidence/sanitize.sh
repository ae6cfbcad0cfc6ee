#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# The engine under gcc's sanitizers, with Eigen's and the engine's own asserts: the C++ tests and tests/engine for memory
# errors and undefined behavior, the latter also with random input, the C++ tests again for data races.
# `sanitize.sh python jobs minutes`, in build/sanitize; minutes of random input.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1 jobs=$2 minutes=$3 status=0
tools=$PWD/$(dirname "$python")

build() { # name, flags, targets
  # Sanitizers make gcc warn of what it cannot see through.
  "$tools"/cmake -S . -B "build/sanitize/$1" -G Ninja -DCMAKE_MAKE_PROGRAM="$tools/ninja" -DDYNAMORPH_TESTS=ON \
    -DDYNAMORPH_PYTHONS="$PWD/$python" -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1 -fno-omit-frame-pointer -D_GLIBCXX_ASSERTIONS $2" -DDYNAMORPH_WERROR=OFF \
    --log-level=WARNING >/dev/null
  "$tools"/cmake --build "build/sanitize/$1" -j"$jobs" --target "${@:3}" -- --quiet
}

# Python is built without a sanitizer: its runtime comes first, and with it the C++ library, or an exception would end the
# process. Python never frees all that it has, so leaks are looked for in C++ alone. The sanitizer reserves more address
# space than a mesher may have: that of children is not limited.
preloaded() {
  local unlimited=$PWD/build/sanitize/unlimited.so
  gcc -shared -fPIC -x c - -o "$unlimited" <<'CODE'
#define _GNU_SOURCE
#include <sys/resource.h>
int setrlimit(__rlimit_resource_t what, const struct rlimit* limit) {
  return what == RLIMIT_AS ? 0 : prlimit(0, what, limit, 0);
}
int setrlimit64(__rlimit_resource_t what, const struct rlimit64* limit) {
  return what == RLIMIT_AS ? 0 : prlimit64(0, what, limit, 0);
}
CODE
  ASAN_OPTIONS=detect_leaks=0:new_delete_type_mismatch=0:alloc_dealloc_mismatch=0:handle_segv=0 \
    LD_PRELOAD="$(g++ -print-file-name=libasan.so) $(g++ -print-file-name=libstdc++.so) $unlimited" \
    PYTHONPATH=$PWD/build/sanitize/address/python:$PWD/addon "$@"
}

# What came of it is kept for docs/reliability.md.
check() { # name, command
  echo "sanitize: $1"
  local found=False
  "${@:2}" || found=True status=1
  PYTHONPATH=tests "$python" -c "import sys, long_runs; long_runs.keep('sanitize', sys.argv[1], failed=$found)" "$1"
}

export UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1
core=core_$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
build address "-fsanitize=address,undefined -fno-sanitize-recover=undefined" engine_tests "$core"
check "memory errors and undefined behavior, C++ tests" build/sanitize/address/engine_tests
# Left out: children that run out of "memory"; programs linked or emulated without a sanitizer; bytes of a release build.
check "memory errors and undefined behavior, tests/engine" preloaded "$python" -m pytest -k "not memory" tests/engine \
  --ignore=tests/engine/test_examples.py --ignore=tests/engine/test_instruction_sets.py \
  --ignore=tests/engine/test_golden.py
DYNAMORPH_FUZZ_MINUTES=$minutes DYNAMORPH_FUZZ_BUILD="under sanitizers" check \
  "memory errors and undefined behavior, random input" preloaded "$python" -m pytest tests/engine/test_fuzz.py \
  tests/engine/test_defects.py
build thread "-fsanitize=thread" engine_tests
TSAN_OPTIONS=halt_on_error=1 check "data races, C++ tests" build/sanitize/thread/engine_tests
exit $status
