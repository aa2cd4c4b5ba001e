# Generates C++ and Python code from schemas/*.fbs at build time with the distribution's own flatc,
# because generated headers only work with the library version that they were generated for.
find_program(ZLOAM_FLATC flatc REQUIRED)
file(GLOB ZLOAM_SCHEMAS CONFIGURE_DEPENDS ${CMAKE_SOURCE_DIR}/schemas/*.fbs)
set(ZLOAM_SCHEMA_CPP_DIR ${CMAKE_BINARY_DIR}/generated/cpp)
set(ZLOAM_SCHEMA_PY_DIR ${CMAKE_BINARY_DIR}/generated/python)
set(ZLOAM_SCHEMA_HEADERS)
foreach(schema IN LISTS ZLOAM_SCHEMAS)
  get_filename_component(name ${schema} NAME_WE)
  list(APPEND ZLOAM_SCHEMA_HEADERS ${ZLOAM_SCHEMA_CPP_DIR}/schemas/${name}_generated.h)
endforeach()
add_custom_command(
  OUTPUT ${ZLOAM_SCHEMA_HEADERS} ${ZLOAM_SCHEMA_PY_DIR}/stamp
  COMMAND ${CMAKE_COMMAND} -E make_directory ${ZLOAM_SCHEMA_CPP_DIR}/schemas ${ZLOAM_SCHEMA_PY_DIR}/zloam/bfbs
  COMMAND ${ZLOAM_FLATC} --cpp --cpp-std c++17 --scoped-enums --reflect-names --require-explicit-ids
          -I ${CMAKE_SOURCE_DIR}/schemas -o ${ZLOAM_SCHEMA_CPP_DIR}/schemas ${ZLOAM_SCHEMAS}
  COMMAND ${ZLOAM_FLATC} --python --require-explicit-ids -I ${CMAKE_SOURCE_DIR}/schemas
          -o ${ZLOAM_SCHEMA_PY_DIR} ${ZLOAM_SCHEMAS}
  COMMAND ${ZLOAM_FLATC} --binary --schema --bfbs-comments --bfbs-builtins -I ${CMAKE_SOURCE_DIR}/schemas
          -o ${ZLOAM_SCHEMA_PY_DIR}/zloam/bfbs ${ZLOAM_SCHEMAS}
  COMMAND ${CMAKE_COMMAND} -E touch ${ZLOAM_SCHEMA_PY_DIR}/stamp
  DEPENDS ${ZLOAM_SCHEMAS}
  COMMENT "flatc: C++, Python and binary schemas from schemas/"
  VERBATIM)
add_custom_target(zloam_schema_files ALL DEPENDS ${ZLOAM_SCHEMA_HEADERS})
add_dependencies(programs zloam_schema_files)
find_path(FLATBUFFERS_INCLUDE_DIR flatbuffers/flatbuffers.h REQUIRED)
find_library(FLATBUFFERS_LIBRARY NAMES flatbuffers REQUIRED)
add_library(zloam_schemas INTERFACE)
target_include_directories(zloam_schemas SYSTEM INTERFACE ${ZLOAM_SCHEMA_CPP_DIR} ${FLATBUFFERS_INCLUDE_DIR})
add_dependencies(zloam_schemas zloam_schema_files)
