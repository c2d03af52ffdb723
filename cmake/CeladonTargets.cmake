include(GoogleTest)

# celadon_library(NAME SOURCES ... [PUBLIC targets] [PRIVATE targets]) makes libceladon_NAME, known as celadon::NAME.
function(celadon_library name)
  cmake_parse_arguments(arg "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(celadon_${name} STATIC ${arg_SOURCES})
  add_library(celadon::${name} ALIAS celadon_${name})
  target_include_directories(celadon_${name} PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}>)
  target_link_libraries(celadon_${name} PUBLIC ${arg_PUBLIC} PRIVATE ${arg_PRIVATE})
endfunction()

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
  target_compile_definitions(${name} PRIVATE CELADON_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}"
                             CELADON_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
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
  target_compile_definitions(${name} PRIVATE CELADON_BIN_DIR="${CMAKE_RUNTIME_OUTPUT_DIRECTORY}")
endfunction()
