# Run at every build: which commit this is, written where it changed. Without a repository: none.
#   cmake -D SOURCE=... -D TARGET=... -P commit.cmake
if(EXISTS ${SOURCE}/.git)  # else it would be that of a repository around it
  execute_process(COMMAND git -C ${SOURCE} rev-parse --short=12 HEAD
    OUTPUT_VARIABLE PALPATE_COMMIT ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
  # Pages are what the numbers go into, not what they come from.
  execute_process(COMMAND git -C ${SOURCE} status --porcelain --untracked-files=no -- . :!docs :!*.md
    OUTPUT_VARIABLE changes ERROR_QUIET)
  if(PALPATE_COMMIT AND changes)
    string(APPEND PALPATE_COMMIT "+")
  endif()
endif()
configure_file(${SOURCE}/engine/commit.cpp.in ${TARGET} @ONLY)
