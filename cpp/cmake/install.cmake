# SPDX-License-Identifier: GPL-3.0-or-later
# `cmake --install build --component engine`: the libraries, their headers and the CMake package that finds them.
include(CMakePackageConfigHelpers)
include(GNUInstallDirs)

set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/dynamorph)
install(TARGETS dynamorph dynamorph_mesher EXPORT dynamorph_targets ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
        COMPONENT engine)
install(DIRECTORY cpp/dynamorph DESTINATION include COMPONENT engine FILES_MATCHING PATTERN *.hpp)
install(FILES LICENSE LICENSES.md DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT engine)
install(EXPORT dynamorph_targets NAMESPACE dynamorph:: FILE dynamorph-targets.cmake DESTINATION ${package_folder}
        COMPONENT engine)
# 0.1 promises nothing to 0.2.
write_basic_package_version_file(${PROJECT_BINARY_DIR}/dynamorph-config-version.cmake COMPATIBILITY SameMinorVersion)
install(FILES cpp/cmake/dynamorph-config.cmake ${PROJECT_BINARY_DIR}/dynamorph-config-version.cmake
        DESTINATION ${package_folder} COMPONENT engine)
