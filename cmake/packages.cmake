# Debian packages by CPack (deploy/build/packages.sh): zenoh-loam contains the programs, the command zloam with
# its Python packages, and a systemd unit; libzenoh-loam-dev contains the headers, static libraries and CMake
# files of the algorithms. The packages contain what `make build` has built; nothing is built for them.
set(CMAKE_SKIP_INSTALL_ALL_DEPENDENCY ON)
set(ZLOAM_HOME lib/zenoh-loam)
set(ZLOAM_PACKAGE ${ZLOAM_HOME}/zloam_monitor)
set(ZLOAM_BUNDLED ${ZLOAM_PACKAGE}/bundled)
install(DIRECTORY ${CMAKE_SOURCE_DIR}/services/monitor/src/zloam_monitor DESTINATION ${ZLOAM_HOME}
  COMPONENT programs PATTERN __pycache__ EXCLUDE)
install(FILES ${ZLOAM_STAGE_FILE} DESTINATION ${ZLOAM_PACKAGE} COMPONENT programs)
install(DIRECTORY ${ZLOAM_SCHEMA_PY_DIR}/zloam DESTINATION ${ZLOAM_BUNDLED}/python COMPONENT programs
  PATTERN __pycache__ EXCLUDE)
install(DIRECTORY ${CMAKE_SOURCE_DIR}/deploy/robots/ DESTINATION ${ZLOAM_BUNDLED}/robots COMPONENT programs)
# The Python packages of services/monitor/requirements.txt (pip --target), made by packages.sh.
install(DIRECTORY ${CMAKE_BINARY_DIR}/site DESTINATION ${ZLOAM_HOME} COMPONENT programs OPTIONAL)
install(PROGRAMS ${CMAKE_SOURCE_DIR}/deploy/debian/zloam DESTINATION bin COMPONENT programs)
install(FILES ${CMAKE_SOURCE_DIR}/deploy/debian/zenoh-loam.service DESTINATION lib/systemd/system
  COMPONENT programs)
install(FILES ${CMAKE_SOURCE_DIR}/LICENSE ${CMAKE_SOURCE_DIR}/THIRD_PARTY.md
  DESTINATION share/doc/zenoh-loam COMPONENT programs)

# The libraries that can be used without Zenoh: the algorithms.
foreach(core geometry plane_map registration odometry mapping integration)
  set_target_properties(zloam_${core} PROPERTIES EXPORT_NAME ${core})
  target_compile_features(zloam_${core} PUBLIC cxx_std_20)
  install(TARGETS zloam_${core} EXPORT zloamTargets ARCHIVE DESTINATION ${ZLOAM_HOME} COMPONENT dev
    INCLUDES DESTINATION include/zenoh-loam)
endforeach()
install(TARGETS zloam_driver ARCHIVE DESTINATION ${ZLOAM_HOME} COMPONENT dev)
set(ZLOAM_CMAKE_FILES lib/cmake/zloam)
install(EXPORT zloamTargets NAMESPACE zloam:: DESTINATION ${ZLOAM_CMAKE_FILES} COMPONENT dev)
include(CMakePackageConfigHelpers)
write_basic_package_version_file(${CMAKE_BINARY_DIR}/zloamConfigVersion.cmake COMPATIBILITY SameMinorVersion)
install(FILES ${CMAKE_SOURCE_DIR}/cmake/zloamConfig.cmake ${CMAKE_BINARY_DIR}/zloamConfigVersion.cmake
  DESTINATION ${ZLOAM_CMAKE_FILES} COMPONENT dev)
install(DIRECTORY ${CMAKE_SOURCE_DIR}/services/ DESTINATION include/zenoh-loam COMPONENT dev
  FILES_MATCHING PATTERN "*.hpp" PATTERN tests EXCLUDE PATTERN monitor EXCLUDE PATTERN router EXCLUDE
  PATTERN runtime EXCLUDE PATTERN zenoh EXCLUDE PATTERN messages EXCLUDE PATTERN io EXCLUDE PATTERN tools EXCLUDE
  PATTERN "*_stage.hpp" EXCLUDE PATTERN "*_parameters.hpp" EXCLUDE PATTERN "test_*.hpp" EXCLUDE)

find_package(Python3 COMPONENTS Interpreter REQUIRED)
math(EXPR ZLOAM_NEXT_PYTHON "${Python3_VERSION_MINOR} + 1")
set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_NAME zenoh-loam)
set(CPACK_PACKAGE_CONTACT "zenoh-loam <zenoh-loam@localhost>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "LiDAR odometry and mapping over Eclipse Zenoh")
set(CPACK_STRIP_FILES ON)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_COMPONENTS_ALL programs dev)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_NAME zenoh-loam)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${CMAKE_BINARY_DIR}/lib)
# Compiled Python packages work with one version of Python only.
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_DEPENDS
  "python3 (>= 3.${Python3_VERSION_MINOR}), python3 (<< 3.${ZLOAM_NEXT_PYTHON})")
set(CPACK_DEBIAN_DEV_PACKAGE_NAME libzenoh-loam-dev)
set(CPACK_DEBIAN_DEV_PACKAGE_DEPENDS libeigen3-dev)
include(CPack)
