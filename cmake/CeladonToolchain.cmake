# Language, warnings, sanitizers, compiler cache and linker: the same for every target.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
set(CMAKE_RUNTIME_OUTPUT_DIRECTORY "${PROJECT_BINARY_DIR}/bin")
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()
set(CMAKE_CXX_FLAGS_RELEASE "-O3 -DNDEBUG")
set(CMAKE_CXX_FLAGS_RELWITHDEBINFO "-O1 -g1")

find_program(CELADON_CCACHE ccache)
if(CELADON_CCACHE AND NOT CMAKE_CXX_COMPILER_LAUNCHER)
  # Precompiled headers are cached only with these; PCH_DEFINES and time macros do not differ between runs here.
  # Paths below the base are hashed as relative ones: a second clone finds what the first compiled.
  set(launcher ${CMAKE_COMMAND} -E env CCACHE_SLOPPINESS=pch_defines,time_macros,include_file_mtime,include_file_ctime
      CCACHE_BASEDIR=${PROJECT_SOURCE_DIR} CCACHE_NOHASHDIR=1 CCACHE_PCH_EXTSUM=1 ${CELADON_CCACHE})
  set(CMAKE_C_COMPILER_LAUNCHER ${launcher})
  set(CMAKE_CXX_COMPILER_LAUNCHER ${launcher})
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  add_compile_options(-fpch-preprocess)  # ccache hashes what a precompiled header holds
  find_program(CELADON_MOLD mold)
  if(CELADON_MOLD)
    add_link_options(-fuse-ld=mold)
  endif()
  # GCC 12 sees overlaps in plain string concatenation that are not there (GCC bug 105651).
  add_compile_options(-Wno-restrict)
else()
  add_compile_options("SHELL:-Xclang -fno-pch-timestamp")
  set(CMAKE_CXX_COMPILE_OPTIONS_USE_PCH -include <PCH_HEADER>)  # as the compiler cache knows it; clang finds what lies beside it
  find_program(CELADON_LLD NAMES ld.lld-14 ld.lld)
  if(CELADON_LLD)
    add_link_options(-fuse-ld=lld)
  endif()
endif()

if(CELADON_WERROR)
  add_compile_options(-Werror)
endif()
if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
  add_compile_options(-Wthread-safety)
endif()
# Results must not depend on which instructions the compiler happens to fuse.
add_compile_options(-Wall -Wextra -Wconversion -Wshadow -ffp-contract=off)
if(CELADON_SANITIZE)
  if(CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    # Relative, so that the compiler cache serves another clone.
    file(RELATIVE_PATH ignored "${PROJECT_BINARY_DIR}" "${PROJECT_SOURCE_DIR}/cmake/sanitizers-ignore.txt")
    add_compile_options(-fsanitize-ignorelist=${ignored})
  endif()
  add_compile_options(-fsanitize=${CELADON_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${CELADON_SANITIZE})
endif()
if(CELADON_COVERAGE)
  add_compile_options(--coverage -O0)
  add_link_options(--coverage)
endif()
