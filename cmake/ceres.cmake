# Target zloam_ceres: the shared library of Ceres with what its headers need. Debian's Ceres::ceres
# is the static library; with the shared one, ldd shows everybody who ships these programs which
# libraries come with them (THIRD_PARTY.md).
include_guard(GLOBAL)
find_package(Ceres REQUIRED)
find_library(CERES_LIBRARY ceres REQUIRED)
get_target_property(CERES_INCLUDES Ceres::ceres INTERFACE_INCLUDE_DIRECTORIES)
get_target_property(CERES_HEADERS_NEED Ceres::ceres INTERFACE_LINK_LIBRARIES)
list(FILTER CERES_HEADERS_NEED INCLUDE REGEX "glog|gflags|Threads|Eigen")
add_library(zloam_ceres INTERFACE)
target_include_directories(zloam_ceres SYSTEM INTERFACE ${CERES_INCLUDES})
target_link_libraries(zloam_ceres INTERFACE ${CERES_LIBRARY} ${CERES_HEADERS_NEED})
