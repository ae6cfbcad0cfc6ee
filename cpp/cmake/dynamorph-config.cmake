# SPDX-License-Identifier: GPL-3.0-or-later
# find_package(dynamorph) -> targets dynamorph::dynamorph, and dynamorph::mesher, which has TetGen
include(CMakeFindDependencyMacro)
find_dependency(Threads)
find_path(DYNAMORPH_EIGEN_INCLUDE Eigen/Dense PATH_SUFFIXES eigen3)
if(NOT DYNAMORPH_EIGEN_INCLUDE)
  set(dynamorph_FOUND FALSE)
  set(dynamorph_NOT_FOUND_MESSAGE "Eigen was not found: set DYNAMORPH_EIGEN_INCLUDE to the folder that holds Eigen/Dense.")
  return()
endif()
include(${CMAKE_CURRENT_LIST_DIR}/dynamorph-targets.cmake)
target_include_directories(dynamorph::dynamorph SYSTEM INTERFACE ${DYNAMORPH_EIGEN_INCLUDE})
