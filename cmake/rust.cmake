# The Rust half of the Zenoh layer: target zloam_zenoh_bridge (imported shared library), built by
# deploy/build/rust.sh, which keeps one library for all build directories. It is compiled without the
# sanitizers of a preset.
set(ZLOAM_ZENOH_LIBRARY "" CACHE FILEPATH "A libzloam_zenoh.so built elsewhere, instead of building it")
# Installed programs find the library beside them.
set(CMAKE_INSTALL_RPATH "$ORIGIN/../lib")

set(ZLOAM_BRIDGE_DIR ${CMAKE_SOURCE_DIR}/services/common/zenoh/bridge)
add_library(zloam_zenoh_bridge SHARED IMPORTED GLOBAL)
if(ZLOAM_ZENOH_LIBRARY)
  set(zloam_bridge_library ${ZLOAM_ZENOH_LIBRARY})
  add_custom_target(zloam_zenoh_bridge_build)
else()
  set(zloam_bridge_library ${CMAKE_BINARY_DIR}/lib/libzloam_zenoh.so)
  file(GLOB zloam_bridge_sources CONFIGURE_DEPENDS ${ZLOAM_BRIDGE_DIR}/src/*.rs)
  add_custom_command(
    OUTPUT ${zloam_bridge_library}
    COMMAND ${CMAKE_SOURCE_DIR}/deploy/build/rust.sh ${zloam_bridge_library}
    DEPENDS ${zloam_bridge_sources} ${ZLOAM_BRIDGE_DIR}/Cargo.toml ${ZLOAM_BRIDGE_DIR}/Cargo.lock
            ${ZLOAM_BRIDGE_DIR}/build.rs ${CMAKE_SOURCE_DIR}/deploy/build/rust.sh
    COMMENT "Rust: libzloam_zenoh.so"
    USES_TERMINAL VERBATIM)
  add_custom_target(zloam_zenoh_bridge_build DEPENDS ${zloam_bridge_library})
endif()
set_target_properties(zloam_zenoh_bridge PROPERTIES
  IMPORTED_LOCATION ${zloam_bridge_library}
  IMPORTED_SONAME libzloam_zenoh.so)
install(PROGRAMS ${zloam_bridge_library} DESTINATION lib/zenoh-loam/zloam_monitor/bundled/lib COMPONENT programs)
