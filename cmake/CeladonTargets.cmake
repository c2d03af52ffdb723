include(GoogleTest)

# celadon_library(NAME SOURCES ... [PUBLIC targets] [PRIVATE targets]) makes libceladon_NAME, known as celadon::NAME.
function(celadon_library name)
  cmake_parse_arguments(arg "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(celadon_${name} STATIC ${arg_SOURCES})
  add_library(celadon::${name} ALIAS celadon_${name})
  target_include_directories(celadon_${name} PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>)
  target_link_libraries(celadon_${name} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
endfunction()

# Where this build's programs and sources lie, for the few tests that ask: a header, so that the compiler cache serves the others.
file(CONFIGURE OUTPUT "${PROJECT_BINARY_DIR}/generated/tests/build_paths.h" CONTENT [[
#pragma once
#define CELADON_BIN_DIR "@CMAKE_RUNTIME_OUTPUT_DIRECTORY@"
#define CELADON_SOURCE_DIR "@PROJECT_SOURCE_DIR@"
]] @ONLY)

# celadon_test(NAME SOURCES ... LINK ... [LABELS ...]) makes a GoogleTest program and registers each of its tests.
function(celadon_test name)
  cmake_parse_arguments(arg "" "TIMEOUT" "SOURCES;LINK;LABELS" ${ARGN})
  if(NOT arg_TIMEOUT)
    set(arg_TIMEOUT 300)
  endif()
  add_executable(${name} ${arg_SOURCES})
  target_include_directories(${name} PRIVATE "${PROJECT_SOURCE_DIR}")
  target_link_libraries(${name} PRIVATE ${arg_LINK} GTest::gtest GTest::gmock GTest::gtest_main)
  # Test programs spend their time in the libraries: compiling them fast is worth more than running them fast.
  target_compile_options(${name} PRIVATE -O1 -Wno-error)
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
