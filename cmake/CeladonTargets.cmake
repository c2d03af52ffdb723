include(GoogleTest)

# Headers of libraries cost more than the code here: they are compiled once for each way of compiling. A holder has one source
# and the headers; targets of the same flags reuse it.
function(celadon_precompiled name)
  cmake_parse_arguments(arg "" "KIND" "HEADERS;OPTIONS;LINK" ${ARGN})
  file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/generated/${name}.cpp" CONTENT "int main() {}\n" @ONLY)
  if(arg_KIND STREQUAL "EXECUTABLE")
    add_executable(${name} "${PROJECT_BINARY_DIR}/generated/${name}.cpp")  # compiled as programs are, position independent
    set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/generated")
  else()
    add_library(${name} OBJECT "${PROJECT_BINARY_DIR}/generated/${name}.cpp")
  endif()
  target_compile_options(${name} PRIVATE ${arg_OPTIONS})
  target_link_libraries(${name} PRIVATE ${arg_LINK})
  target_precompile_headers(${name} PRIVATE ${arg_HEADERS})
  # What compilers write differs from one time to the next, and with the clone's path. The compiler cache takes this sum in
  # place of the contents: all they depend on but the command, which it looks at anyway, are the installed packages.
  set(packages "")
  if(EXISTS /var/lib/dpkg/status)
    file(SHA256 /var/lib/dpkg/status packages)
  endif()
  set(written gch)
  if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    set(written pch)
  endif()
  file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/CMakeFiles/${name}.dir/cmake_pch.hxx.${written}.sum"
       CONTENT "${CMAKE_CXX_COMPILER_VERSION} ${packages} ${arg_HEADERS} ${arg_OPTIONS}\n" @ONLY)
endfunction()

set(common_headers <algorithm> <chrono> <cmath> <filesystem> <functional> <memory> <optional> <random> <span> <string> <vector>
    <tl/expected.hpp> <Eigen/Core> <Eigen/Geometry>)
celadon_precompiled(celadon_headers HEADERS ${common_headers} <Eigen/Dense> LINK Eigen3::Eigen)
celadon_precompiled(celadon_json_headers HEADERS ${common_headers} <nlohmann/json.hpp>
                    LINK Eigen3::Eigen nlohmann_json::nlohmann_json)
celadon_precompiled(celadon_cold_headers HEADERS ${common_headers} <nlohmann/json.hpp> OPTIONS -O1
                    LINK Eigen3::Eigen nlohmann_json::nlohmann_json)
# Test programs spend their time in the libraries: compiling them fast is worth more than running them fast. Not below -O1:
# of a template that both instantiate the linker keeps the test's.
set(test_optimisation -O1)
if(CELADON_BUILD_TESTS)
  celadon_precompiled(celadon_test_headers KIND EXECUTABLE OPTIONS ${test_optimisation}
                      HEADERS ${common_headers} <nlohmann/json.hpp> <gtest/gtest.h> <gmock/gmock.h> <rapidcheck/gtest.h>
                      LINK Eigen3::Eigen nlohmann_json::nlohmann_json GTest::gtest GTest::gmock)
endif()

# celadon_library(NAME SOURCES ... [PUBLIC targets] [PRIVATE targets] [HEADERS holder] [COLD]) makes libceladon_NAME, known as
# celadon::NAME. COLD: it spends its time in other libraries, so compiling it fast is worth more than running it fast.
function(celadon_library name)
  cmake_parse_arguments(arg "COLD" "HEADERS" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(celadon_${name} STATIC ${arg_SOURCES})
  add_library(celadon::${name} ALIAS celadon_${name})
  target_include_directories(celadon_${name} PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>)
  target_link_libraries(celadon_${name} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
  if(arg_COLD)
    target_compile_options(celadon_${name} PRIVATE -O1)
    set(arg_HEADERS celadon_cold_headers)
  endif()
  if(arg_HEADERS)
    target_precompile_headers(celadon_${name} REUSE_FROM ${arg_HEADERS})
  endif()
endfunction()

# Where this build's programs and sources lie, for the few tests that ask: a header, so that the compiler cache serves the others.
file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/generated/tests/build_paths.h" CONTENT [[
#pragma once
#define CELADON_BIN_DIR "@CMAKE_RUNTIME_OUTPUT_DIRECTORY@"
#define CELADON_SOURCE_DIR "@PROJECT_SOURCE_DIR@"
]] @ONLY)

# celadon_test(NAME SOURCES ... LINK ... [LABELS ...] [APART ...]) makes a GoogleTest program and registers each of its tests. APART:
# of its sources those that name alike what another has too; they are not compiled together with the others.
function(celadon_test name)
  cmake_parse_arguments(arg "" "TIMEOUT" "SOURCES;LINK;LABELS;APART" ${ARGN})
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_include_directories(${name} PRIVATE "${PROJECT_SOURCE_DIR}")
  target_link_libraries(${name} PRIVATE ${arg_LINK} GTest::gtest GTest::gmock GTest::gtest_main)
  target_compile_options(${name} PRIVATE ${test_optimisation})
  target_precompile_headers(${name} REUSE_FROM celadon_test_headers)
  set_source_files_properties(${arg_APART} PROPERTIES SKIP_UNITY_BUILD_INCLUSION ON)
  target_include_directories(${name} PRIVATE "${PROJECT_BINARY_DIR}/generated")
  if("threads" IN_LIST arg_LABELS)
    add_dependencies(tsan_tests ${name})
  endif()
  gtest_discover_tests(${name} DISCOVERY_MODE PRE_TEST PROPERTIES TIMEOUT ${arg_TIMEOUT} LABELS "${arg_LABELS}")
endfunction()

# What the thread sanitizer's build makes: celadon_test programs with the label "threads".
add_custom_target(tsan_tests)

# celadon_campaign(NAME SOURCES ... LINK ...) makes a program that tools/campaign NAME runs and whose result it keeps.
function(celadon_campaign name)
  cmake_parse_arguments(arg "" "" "SOURCES;LINK" ${ARGN})
  add_executable(${name} ${arg_SOURCES})
  target_include_directories(${name} PRIVATE "${PROJECT_SOURCE_DIR}")
  target_link_libraries(${name} PRIVATE ${arg_LINK})
endfunction()
