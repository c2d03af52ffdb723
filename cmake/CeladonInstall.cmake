# cmake --install: the programs, and the fitting library as a package for find_package(celadon).
include(GNUInstallDirs)
include(CMakePackageConfigHelpers)

install(TARGETS celadon celadond celadon-sim)
if(TARGET celadon-cad)
  install(TARGETS celadon-cad)  # looked for beside the programs
endif()

set(package_dir "${CMAKE_INSTALL_LIBDIR}/cmake/celadon")
set_target_properties(celadon_fitting PROPERTIES EXPORT_NAME fitting)
target_include_directories(celadon_fitting PUBLIC $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}/celadon>)
target_compile_features(celadon_fitting PUBLIC cxx_std_20)
install(TARGETS celadon_fitting EXPORT celadon)
install(DIRECTORY "${PROJECT_SOURCE_DIR}/fitting" DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}/celadon"
        FILES_MATCHING PATTERN "*.h" PATTERN example EXCLUDE PATTERN figures EXCLUDE)
install(EXPORT celadon NAMESPACE celadon:: DESTINATION "${package_dir}" FILE celadon-targets.cmake)
write_basic_package_version_file(celadon-config-version.cmake COMPATIBILITY SameMinorVersion)
file(CONFIGURE OUTPUT celadon-config.cmake CONTENT [[
include(CMakeFindDependencyMacro)
find_dependency(Eigen3)
find_dependency(PkgConfig)
if(NOT TARGET PkgConfig::HWY)
  pkg_check_modules(HWY REQUIRED IMPORTED_TARGET libhwy)
endif()
include("${CMAKE_CURRENT_LIST_DIR}/celadon-targets.cmake")
]] @ONLY)
install(FILES "${PROJECT_BINARY_DIR}/celadon-config.cmake" "${PROJECT_BINARY_DIR}/celadon-config-version.cmake"
        DESTINATION "${package_dir}")
