# Writes CTest's list of the processes of a Catch2 program. One process runs many cases, because most cases take less
# time than the start of a process. Each case with [host] has its own process, so that CTest repeats only the one that
# failed.
#   cmake -D CATCH2=VERSION -D PROGRAM=... -D OUT=... -D ROOM=... "-D SETS=NAME|SPEC|LABEL,LABEL|host or -|COST;..." -P list_shards.cmake
# A set that matches no case of the program gives no test.
cmake_policy(VERSION 3.22)
# A program of Catch2 2 has another option that lists its tests. Without "--warn NoTests" it succeeds if it selects none.
set(listing --list-tests --verbosity quiet)
set(strict "")
if(CATCH2 VERSION_LESS 3)
  set(listing --list-test-names-only)
  set(strict "--warn NoTests ")
endif()
set(script "")
set(counts "")
foreach(set IN LISTS SETS)
  string(REPLACE "|" ";" fields "${set}")
  list(GET fields 0 name)
  list(GET fields 1 spec)
  list(GET fields 2 labels)
  list(GET fields 3 host)
  list(GET fields 4 cost)
  string(REPLACE "," ";" labels "${labels}")
  execute_process(COMMAND ${PROGRAM} ${listing} "${spec}"
                  OUTPUT_VARIABLE cases ERROR_VARIABLE trouble)
  if(NOT trouble STREQUAL "")
    message(FATAL_ERROR "${PROGRAM} ${listing}: ${trouble}")
  endif()
  # A test name may contain the character that separates the items of a CMake list. list(FILTER) would drop the escapes,
  # so empty lines are removed while the names are still one text.
  string(REGEX REPLACE "\n+" "\n" cases "${cases}")
  string(STRIP "${cases}" cases)
  string(REPLACE ";" "\\;" cases "${cases}")
  string(REPLACE "\n" ";" cases "${cases}")
  list(LENGTH cases count)
  if(count EQUAL 0)
    continue()
  endif()
  set(properties "ENVIRONMENT PALPATE_ROOM=${ROOM} COST ${cost}")
  if(host STREQUAL "-")
    string(APPEND counts "${count} ${name}\n")
    string(APPEND script "add_test([==[${name}]==] [==[${PROGRAM}]==] ${strict}[==[${spec}]==])\n"
      "set_tests_properties([==[${name}]==] PROPERTIES LABELS \"${labels}\" ${properties})\n")
    continue()
  endif()
  foreach(case IN LISTS cases)
    set(only "${case}")
    foreach(special "\\" "," "[" "]")
      string(REPLACE "${special}" "\\${special}" only "${only}")
    endforeach()
    string(APPEND script "add_test([==[${name}.${case}]==] [==[${PROGRAM}]==] ${strict}[==[${only}]==])\n"
      "set_tests_properties([==[${name}.${case}]==] PROPERTIES LABELS \"${labels};host\" RUN_SERIAL ON ${properties})\n")
  endforeach()
endforeach()
file(WRITE ${OUT} "${script}")
file(WRITE ${OUT}.counts "${counts}")
