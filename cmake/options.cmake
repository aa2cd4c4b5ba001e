# Language, warnings and build options of all targets.
set(CMAKE_CXX_STANDARD 20)
set(CMAKE_CXX_STANDARD_REQUIRED ON)
set(CMAKE_CXX_EXTENSIONS OFF)
set(CMAKE_POSITION_INDEPENDENT_CODE ON)
if(NOT CMAKE_BUILD_TYPE)
  set(CMAKE_BUILD_TYPE Release CACHE STRING "" FORCE)
endif()

option(ZLOAM_WERROR "Warnings are errors" ON)
option(ZLOAM_TESTS "Unit tests and benchmarks, and GTest and Ceres for them" ON)
option(ZLOAM_ALOAM "A-LOAM's stages, and PCL and Ceres for them" ON)
option(ZLOAM_GRAPH "The graph of loops, and OpenCV and Ceres for it" ON)
set(ZLOAM_SANITIZE "" CACHE STRING "Sanitizers, e.g. address,undefined")

find_program(ZLOAM_CCACHE ccache)
if(ZLOAM_CCACHE)
  set(CMAKE_CXX_COMPILER_LAUNCHER ${ZLOAM_CCACHE})
  set(CMAKE_C_COMPILER_LAUNCHER ${ZLOAM_CCACHE})
endif()

# No implicit fused multiply-add: the same source must give the same bytes with every build by one
# compiler, and -O levels may otherwise contract differently (docs/protocol.md, section 8).
add_compile_options(-ffp-contract=off)
add_compile_options($<$<COMPILE_LANGUAGE:CXX>:-Wall> $<$<COMPILE_LANGUAGE:CXX>:-Wextra>
                    $<$<COMPILE_LANGUAGE:CXX>:-Wshadow> $<$<COMPILE_LANGUAGE:CXX>:-Wnon-virtual-dtor>)
if(ZLOAM_WERROR)
  add_compile_options($<$<COMPILE_LANGUAGE:CXX>:-Werror>)
endif()
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU")
  # False positives of GCC 12's flow analysis inside Eigen, std::vector and std::string at -O3.
  add_compile_options(-Wno-maybe-uninitialized -Wno-array-bounds -Wno-stringop-overflow -Wno-restrict)
endif()
if(ZLOAM_SANITIZE)
  add_compile_options(-fsanitize=${ZLOAM_SANITIZE} -fno-omit-frame-pointer -fno-sanitize-recover=all)
  add_link_options(-fsanitize=${ZLOAM_SANITIZE})
endif()

set(CMAKE_RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/bin)
set(CMAKE_LIBRARY_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/lib)

# Environment of the tests. The Rust half of the Zenoh layer is not instrumented: TSan does not see its
# synchronisation and would report all data that it passes from one thread to another.
set(ZLOAM_TEST_ENVIRONMENT UBSAN_OPTIONS=print_stacktrace=1)
if(ZLOAM_SANITIZE MATCHES "thread")
  set(ZLOAM_TEST_ENVIRONMENT TSAN_OPTIONS=ignore_noninstrumented_modules=1:suppressions=${CMAKE_SOURCE_DIR}/tests/tsan.supp)
endif()
# The programs that a robot runs, without tests and benchmarks (make build).
add_custom_target(programs)
# All unit tests and their dependencies, without the programs (make sanitize).
add_custom_target(unit_tests)

# Installs a program into the packages.
function(zloam_packed name)
  install(TARGETS ${name} RUNTIME DESTINATION lib/zenoh-loam/zloam_monitor/bundled/bin COMPONENT programs)
endfunction()

# Adds a program that runs on a robot or beside one.
function(zloam_program name)
  add_executable(${name} ${ARGN})
  add_dependencies(programs ${name})
  zloam_packed(${name})
endfunction()

# Adds a unit test program: zloam_test(NAME name SOURCES a.cpp LIBS lib1 lib2)
function(zloam_test)
  if(NOT ZLOAM_TESTS)
    return()
  endif()
  cmake_parse_arguments(T "" "NAME" "SOURCES;LIBS" ${ARGN})
  add_executable(${T_NAME} ${T_SOURCES})
  target_link_libraries(${T_NAME} PRIVATE ${T_LIBS} GTest::gtest_main GTest::gmock)
  set_target_properties(${T_NAME} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  add_dependencies(unit_tests ${T_NAME})
  gtest_discover_tests(${T_NAME} DISCOVERY_MODE PRE_TEST
    PROPERTIES TIMEOUT 300 ENVIRONMENT ${ZLOAM_TEST_ENVIRONMENT})
endfunction()
