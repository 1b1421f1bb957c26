# Writes the commit that is being built into OUTPUT, a header; leaves it alone where nothing changed.
#   cmake -D SOURCE=... -D OUTPUT=... -P commit.cmake
execute_process(COMMAND git -C ${SOURCE} rev-parse --short=12 HEAD
  OUTPUT_VARIABLE COMMIT OUTPUT_STRIP_TRAILING_WHITESPACE ERROR_QUIET RESULT_VARIABLE STATUS)
if(STATUS EQUAL 0)
  # Pages are what the numbers go into, not what they come from.
  execute_process(COMMAND git -C ${SOURCE} status --porcelain --untracked-files=no -- . :!docs :!*.md
    OUTPUT_VARIABLE CHANGES ERROR_QUIET)
  if(CHANGES)
    string(APPEND COMMIT "+")
  endif()
else()
  set(COMMIT "unknown")
endif()
set(TEXT "// Made by CMake.
#pragma once
namespace palpate::bench {
inline constexpr char kCommit[] = \"${COMMIT}\";
}  // namespace palpate::bench
")
set(OLD "")
if(EXISTS ${OUTPUT})
  file(READ ${OUTPUT} OLD)
endif()
if(NOT OLD STREQUAL TEXT)
  file(WRITE ${OUTPUT} "${TEXT}")
endif()
