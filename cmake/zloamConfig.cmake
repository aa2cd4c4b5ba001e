# Package file for find_package(zloam): the algorithms, without transport (docs/library.md).
include(CMakeFindDependencyMacro)
find_dependency(Eigen3)
include(${CMAKE_CURRENT_LIST_DIR}/zloamTargets.cmake)
