#!/bin/bash
# SPDX-License-Identifier: GPL-3.0-or-later
# The engine under gcc's sanitizers, with Eigen's and the engine's own asserts: the C++ tests and tests/engine for memory
# errors and undefined behavior, the C++ tests again for data races. `sanitize.sh python jobs`, in build/sanitize.
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1 jobs=$2
tools=$PWD/$(dirname "$python")

build() { # name, flags, targets
  # Sanitizers make gcc warn of what it cannot see through.
  "$tools"/cmake -S . -B "build/sanitize/$1" -G Ninja -DCMAKE_MAKE_PROGRAM="$tools/ninja" -DDYNAMORPH_TESTS=ON \
    -DDYNAMORPH_PYTHONS="$PWD/$python" -DCMAKE_BUILD_TYPE=RelWithDebInfo \
    -DCMAKE_CXX_FLAGS_RELWITHDEBINFO="-O1 -g1 -fno-omit-frame-pointer -D_GLIBCXX_ASSERTIONS -Wno-error $2" \
    --log-level=WARNING >/dev/null
  "$tools"/cmake --build "build/sanitize/$1" -j"$jobs" --target "${@:3}" -- --quiet
}

# Python is built without a sanitizer: its runtime comes first, and with it the C++ library, or an exception would end the
# process. Python never frees all that it has, so leaks are looked for in C++ alone. The sanitizer reserves more address
# space than a mesher may have: children are not limited.
preloaded() {
  local unlimited=$PWD/build/sanitize/unlimited.so
  echo 'extern "C" { int setrlimit(int, const void*) { return 0; } int setrlimit64(int, const void*) { return 0; } }' |
    g++ -shared -fPIC -x c++ - -o "$unlimited"
  ASAN_OPTIONS=detect_leaks=0:new_delete_type_mismatch=0:alloc_dealloc_mismatch=0:handle_segv=0 \
    LD_PRELOAD="$(g++ -print-file-name=libasan.so) $(g++ -print-file-name=libstdc++.so) $unlimited" \
    PYTHONPATH=$PWD/build/sanitize/address/python:$PWD/addon "$@"
}

export UBSAN_OPTIONS=print_stacktrace=1:halt_on_error=1
core=core_$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
echo "sanitize: memory errors and undefined behavior, C++"
build address "-fsanitize=address,undefined -fno-sanitize-recover=undefined" engine_tests "$core"
build/sanitize/address/engine_tests
echo "sanitize: memory errors and undefined behavior, tests/engine"
# Left out: children that run out of "memory"; programs linked or emulated without a sanitizer.
preloaded "$python" -m pytest -k "not memory" tests/engine --ignore=tests/engine/test_examples.py \
  --ignore=tests/engine/test_instruction_sets.py
echo "sanitize: data races, C++"
build thread "-fsanitize=thread" engine_tests
TSAN_OPTIONS=halt_on_error=1 build/sanitize/thread/engine_tests
