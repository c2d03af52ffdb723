# The line extraction and its tests for arm64, run by QEMU: no processor of that kind is needed to know that NEON finds the
# same lines. Highway is headers alone here (one target, nothing to dispatch); GoogleTest comes as source.
if(CELADON_SANITIZE OR CMAKE_SYSTEM_PROCESSOR MATCHES "aarch64|arm64")
  return()  # once is enough; on such a machine laser_line_tests are these tests
endif()

find_program(CELADON_ARM64_CXX aarch64-linux-gnu-g++)
find_program(CELADON_ARM64_QEMU NAMES qemu-aarch64-static qemu-aarch64)
set(googletest /usr/src/googletest/googletest)
if(NOT CELADON_ARM64_CXX OR NOT CELADON_ARM64_QEMU OR NOT EXISTS "${googletest}/src/gtest-all.cc")
  add_test(NAME LaserLineOnArm64 COMMAND sh -c
    "echo 'NEON is not tested: aarch64-linux-gnu-g++, qemu-aarch64-static or ${googletest} is missing; run tools/install build test and configure again' >&2; exit 1")
  return()
endif()

# The host's other headers must not be seen by this compiler.
set(arm64 "${CMAKE_CURRENT_BINARY_DIR}/arm64")
find_path(hwy_folder hwy/highway.h REQUIRED)
find_path(tl_folder tl/expected.hpp REQUIRED)
file(MAKE_DIRECTORY "${arm64}/include")
file(CREATE_LINK "${hwy_folder}/hwy" "${arm64}/include/hwy" SYMBOLIC)
file(CREATE_LINK "${tl_folder}/tl" "${arm64}/include/tl" SYMBOLIC)

set(arm64_flags -std=c++20 -ffp-contract=off -DHWY_COMPILE_ONLY_STATIC "-I${PROJECT_SOURCE_DIR}" -isystem
    "${arm64}/include" -isystem "${googletest}/include" -isystem "${googletest}")
if(CELADON_WERROR)
  list(APPEND arm64_flags -Wall -Wextra -Wno-restrict -Werror)
endif()
foreach(source acquisition/laser_line.cpp acquisition/laser_line_simd.cpp acquisition/line_continuity.cpp
        acquisition/line_smoothing.cpp tests/acquisition/laser_line_accuracy_test.cpp
        tests/acquisition/laser_line_columns_test.cpp tests/acquisition/laser_line_test.cpp
        tests/acquisition/line_continuity_test.cpp "${googletest}/src/gtest-all.cc" "${googletest}/src/gtest_main.cc")
  cmake_path(GET source FILENAME name)
  cmake_path(ABSOLUTE_PATH source BASE_DIRECTORY "${PROJECT_SOURCE_DIR}")
  set(optimised -O2)
  if(name MATCHES "gtest")
    set(optimised -O0)
  endif()
  add_custom_command(OUTPUT "${arm64}/${name}.o"
    COMMAND ${CMAKE_CXX_COMPILER_LAUNCHER} "${CELADON_ARM64_CXX}" ${arm64_flags} ${optimised} -MD -MF "${arm64}/${name}.d" -c
            "${source}" -o "${arm64}/${name}.o"
    DEPENDS "${source}" DEPFILE "${arm64}/${name}.d" VERBATIM)
  list(APPEND arm64_objects "${arm64}/${name}.o")
endforeach()
set(arm64_program "${CMAKE_RUNTIME_OUTPUT_DIRECTORY}/laser_line_tests_arm64")
add_custom_command(OUTPUT "${arm64_program}" COMMAND "${CELADON_ARM64_CXX}" -static ${arm64_objects} -o "${arm64_program}"
  DEPENDS ${arm64_objects} VERBATIM)
add_custom_target(laser_line_tests_arm64 ALL DEPENDS "${arm64_program}")

# A processor that is emulated is slow: those that do the same many times over for the sake of statistics are left out.
add_test(NAME LaserLineOnArm64 COMMAND "${CELADON_ARM64_QEMU}" "${arm64_program}"
  "--gtest_filter=-*NoBias*:*NoiseIsNoLine*:*Defaults*:*AnyStride*:*GivesTheRows*:*OcclusionEdges*:*WithoutASecondLine*")
set_tests_properties(LaserLineOnArm64 PROPERTIES TIMEOUT 300)
