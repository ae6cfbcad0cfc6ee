# SPDX-License-Identifier: GPL-3.0-or-later
# Sets tetgen_dir: TetGen 1.6's sources, from the sdist pinned in tools/tetgen.txt. Fetched once, kept in build/tetgen.
file(STRINGS ${PROJECT_SOURCE_DIR}/tools/tetgen.txt pin REGEX "^tetgen==")
string(REGEX MATCH "tetgen==([0-9.]+) --hash=sha256:([0-9a-f]+)" pin "${pin}")
set(tetgen_version ${CMAKE_MATCH_1})
set(tetgen_sha256 ${CMAKE_MATCH_2})
set(tetgen_cache ${PROJECT_SOURCE_DIR}/build/tetgen)
set(archive ${tetgen_cache}/tetgen-${tetgen_version}.tar.gz)
if(NOT EXISTS ${archive})
  message(STATUS "Fetching TetGen's sources")
  # pip reads the sdist's metadata through its build backend: scikit-build-core, which is there already.
  execute_process(
    COMMAND ${python} -m pip download --quiet --disable-pip-version-check --no-deps --no-binary :all:
            --no-build-isolation --require-hashes -r ${PROJECT_SOURCE_DIR}/tools/tetgen.txt -d ${tetgen_cache})
endif()
if(NOT EXISTS ${archive})
  message(FATAL_ERROR
          "TetGen's sources could not be downloaded. Without a network, take tetgen-${tetgen_version}.tar.gz "
          "from https://pypi.org/project/tetgen/${tetgen_version}/#files to ${tetgen_cache}: "
          "its SHA-256 is ${tetgen_sha256}.")
endif()
file(SHA256 ${archive} sha256)
if(NOT sha256 STREQUAL tetgen_sha256)
  message(FATAL_ERROR "${archive} is not the file pinned in tools/tetgen.txt: delete it and configure again.")
endif()
file(ARCHIVE_EXTRACT INPUT ${archive} DESTINATION ${tetgen_cache}
     PATTERNS */tetgen.cxx */predicates.cxx */tetgen.h */tetgen-license)
set(tetgen_dir ${tetgen_cache}/tetgen-${tetgen_version}/src)
