# Test suites. `thread_tests` are those worth running under ThreadSanitizer; `tests` are all.
# An installation's build tree does not configure them: only they need doctest.
add_custom_target(thread_tests)
add_custom_target(tests DEPENDS thread_tests)

find_path(DOCTEST_INCLUDE_DIR doctest/doctest.h)
if(NOT DOCTEST_INCLUDE_DIR)
  message(FATAL_ERROR "doctest not found: on Debian and Ubuntu, 'apt install doctest-dev'; or set "
                      "DOCTEST_INCLUDE_DIR to the folder that holds doctest/doctest.h")
endif()
# A copy in a folder of its own: a cross compiler must not search the host's /usr/include.
configure_file(${DOCTEST_INCLUDE_DIR}/doctest/doctest.h
               ${PROJECT_BINARY_DIR}/doctest/doctest/doctest.h COPYONLY)

# The main function and what the suites share. Sanitizers report crashes better than doctest does.
add_library(testing OBJECT EXCLUDE_FROM_ALL common/test/main.cpp)
target_include_directories(testing PUBLIC common/test)
target_include_directories(testing SYSTEM PUBLIC ${PROJECT_BINARY_DIR}/doctest)
target_compile_definitions(testing PUBLIC
  DOCTEST_CONFIG_SUPER_FAST_ASSERTS
  DOCTEST_CONFIG_NO_TRY_CATCH_IN_ASSERTS
  DOCTEST_CONFIG_NO_POSIX_SIGNALS)
if(MAPPERD_SANITIZE)
  target_compile_definitions(testing PUBLIC MAPPERD_SANITIZED)
endif()

# Each source file `test/test_<name>.cpp` of a suite is one test of CTest, `<suite>.<name>`.
function(mapperd_add_test_suite suite)
  cmake_parse_arguments(PARSE_ARGV 1 suite "THREADS" "" "SOURCES;LIBRARIES")
  add_executable(${suite} EXCLUDE_FROM_ALL ${suite_SOURCES})
  target_link_libraries(${suite} PRIVATE testing ${suite_LIBRARIES} Threads::Threads)
  set_target_properties(${suite} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/test)
  add_dependencies(tests ${suite})
  if(suite_THREADS)
    add_dependencies(thread_tests ${suite})
  endif()
  if(NOT MAPPERD_SANITIZE)
    # Tests need not be fast; the libraries that they test are compiled as they are shipped.
    target_compile_options(${suite} PRIVATE $<$<CONFIG:Release>:-O1>)
  endif()
  foreach(source IN LISTS suite_SOURCES)
    if(source MATCHES "test/test_(.*)\\.cpp$")
      add_test(NAME ${suite}.${CMAKE_MATCH_1}
               COMMAND ${suite} --source-file=*test_${CMAKE_MATCH_1}.cpp --no-version --no-intro)
    endif()
  endforeach()
endfunction()
