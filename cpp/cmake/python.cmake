# SPDX-License-Identifier: GPL-3.0-or-later
# An importable package `dynamorph` in the build directory, with its modules for each Python in DYNAMORPH_PYTHONS.
# Not by pybind11's own CMake package: it serves one Python a build directory, and each would compile the engine again.

file(GLOB binding_sources CONFIGURE_DEPENDS cpp/bindings/*.cpp)
set(mesher_binding ${PROJECT_SOURCE_DIR}/cpp/bindings/mesher.cpp)
list(REMOVE_ITEM binding_sources ${mesher_binding})
file(GLOB package_files CONFIGURE_DEPENDS cpp/bindings/dynamorph/*.py cpp/bindings/dynamorph/*.pyi
     cpp/bindings/dynamorph/py.typed)
set(package_dir ${PROJECT_BINARY_DIR}/python/dynamorph) # links to the sources, modules beside them
file(REMOVE_RECURSE ${package_dir}/__pycache__)
file(MAKE_DIRECTORY ${package_dir})
foreach(file ${package_files})
  get_filename_component(name ${file} NAME)
  file(CREATE_LINK ${file} ${package_dir}/${name} SYMBOLIC COPY_ON_ERROR) # Windows may refuse links
endforeach()

include(CheckLinkerFlag)
check_linker_flag(CXX LINKER:--exclude-libs,ALL exclude_libs) # zig's linker does not know it, nor need it

set(kind MODULE)
if(APPLE AND CMAKE_CROSSCOMPILING)
  set(kind SHARED) # zig makes no bundles; Python loads both
endif()

# A target core_3.11 or mesher_3.11; the sources are the last arguments.
function(add_module name library version include suffix libraries)
  set(target ${name}_${version})
  add_library(${target} ${kind} ${ARGN})
  target_compile_options(${target} PRIVATE ${options})
  target_include_directories(${target} SYSTEM PRIVATE ${include} ${python_pybind11_include})
  if(WIN32)
    string(REPLACE "." "" number ${version})
    target_link_directories(${target} PRIVATE ${libraries})
    target_link_libraries(${target} PRIVATE python${number})
  elseif(APPLE)
    target_link_options(${target} PRIVATE LINKER:-undefined,dynamic_lookup)
  else()
    # No dependency on the artist's libstdc++; symbols of the static engine stay inside the module.
    if(exclude_libs)
      target_link_options(${target} PRIVATE LINKER:--exclude-libs,ALL)
    endif()
    if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
      target_link_options(${target} PRIVATE -static-libstdc++ -static-libgcc)
    endif()
  endif()
  target_link_libraries(${target} PRIVATE ${library})
  set_target_properties(${target} PROPERTIES PREFIX "" OUTPUT_NAME _${name} SUFFIX ${suffix}
                        LIBRARY_OUTPUT_DIRECTORY ${package_dir})
  install(TARGETS ${target} LIBRARY DESTINATION dynamorph COMPONENT python)
endfunction()

function(add_modules version)
  add_module(core dynamorph ${version} ${ARGN} ${binding_sources})
  add_module(mesher dynamorph_mesher ${version} ${ARGN} ${mesher_binding})
  add_dependencies(core_${version} mesher_${version}) # the package needs both
endfunction()

foreach(python ${DYNAMORPH_PYTHONS})
  describe_python(${python})
  if(NOT CMAKE_CROSSCOMPILING)
    add_modules(${python_version} ${python_include} ${python_suffix} ${python_prefix}/libs)
  endif()
endforeach()
foreach(python ${DYNAMORPH_CROSS_PYTHONS})
  string(REPLACE "|" ";" facts ${python})
  add_modules(${facts} ${PROJECT_BINARY_DIR})
endforeach()
