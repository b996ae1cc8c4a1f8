# Test suites. `thread_tests` are those worth running under ThreadSanitizer; `tests` are all.
# The install's build tree configures them too and builds none.
set(MAPPERD_SUITE_PARTS 6)  # each suite runs as so many tests with a part of its cases, in parallel
add_custom_target(thread_tests)
add_custom_target(tests DEPENDS thread_tests)

add_library(check OBJECT EXCLUDE_FROM_ALL common/test/check.cpp common/test/main.cpp)
target_include_directories(check PUBLIC common/test)

function(mapperd_add_test_suite suite)
  cmake_parse_arguments(PARSE_ARGV 1 suite "THREADS" "" "SOURCES;LIBRARIES")
  add_executable(${suite} EXCLUDE_FROM_ALL ${suite_SOURCES})
  target_link_libraries(${suite} PRIVATE check ${suite_LIBRARIES} Threads::Threads)
  set_target_properties(${suite} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/test)
  add_dependencies(tests ${suite})
  if(suite_THREADS)
    add_dependencies(thread_tests ${suite})
  endif()
  if(NOT MAPPERD_SANITIZE)
    # Tests need not be fast; the libraries that they test are compiled as they are shipped.
    target_compile_options(${suite} PRIVATE $<$<CONFIG:Release>:-O1>)
  endif()
  math(EXPR last "${MAPPERD_SUITE_PARTS} - 1")
  foreach(part RANGE ${last})
    add_test(NAME ${suite}_${part} COMMAND ${suite} ${part} ${MAPPERD_SUITE_PARTS})
    if(MAPPERD_SANITIZE)
      # Under sanitizers the oracle is some twenty times slower: two scenes reach all the code.
      set_tests_properties(${suite}_${part} PROPERTIES ENVIRONMENT "MAPPERD_ORACLE_SCENES=2")
    endif()
  endforeach()
endfunction()
