# Run at every build: which commit this is, written where it changed. Without a repository: none.
if(EXISTS ${SOURCE}/.git)  # else it would be that of a repository around it
  execute_process(COMMAND git -C ${SOURCE} describe --always --dirty --abbrev=12 --exclude=*
    OUTPUT_VARIABLE PALPATE_COMMIT ERROR_QUIET OUTPUT_STRIP_TRAILING_WHITESPACE)
endif()
configure_file(${SOURCE}/scenes/commit.cpp.in ${TARGET} @ONLY)
