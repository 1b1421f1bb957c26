# Runs at every configuration and build. Writes TARGET, a C++ file with the commit of SOURCE, if its text has changed.
# Without a repository the commit is empty. Usage:
#   cmake -D SOURCE=... -D TARGET=... -P commit.cmake
if(EXISTS ${SOURCE}/.git)  # otherwise git would report the commit of an enclosing repository
  execute_process(COMMAND git -C ${SOURCE} rev-parse --short=12 HEAD
    OUTPUT_VARIABLE PALPATE_COMMIT ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
  # Excludes documents, because a changed document does not change the program.
  execute_process(COMMAND git -C ${SOURCE} status --porcelain --untracked-files=no -- . :!docs :!*.md
    OUTPUT_VARIABLE changes ERROR_QUIET)
  if(PALPATE_COMMIT AND changes)
    string(APPEND PALPATE_COMMIT "+")
  endif()
endif()
configure_file(${SOURCE}/engine/commit.cpp.in ${TARGET} @ONLY)
