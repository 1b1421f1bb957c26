# Builds the libFuzzer target for the parser of Haply's messages. It needs clang and is run by hand.
option(PALPATE_FUZZ "Build the fuzzers (clang only)" OFF)
if(PALPATE_FUZZ AND TARGET palpate_haply_messages)
  if(NOT CMAKE_CXX_COMPILER_ID MATCHES "Clang")
    message(FATAL_ERROR "PALPATE_FUZZ needs clang: set CMAKE_CXX_COMPILER to clang++")
  endif()
  # Compiles the parser again, with the fuzzer's instrumentation.
  add_executable(palpate_fuzz_haply_messages
    ${CMAKE_CURRENT_LIST_DIR}/haply_messages.cpp
    ${PROJECT_SOURCE_DIR}/devices/plugins/haply_messages.cpp)
  target_include_directories(palpate_fuzz_haply_messages PRIVATE ${PALPATE_INCLUDE})
  target_compile_options(palpate_fuzz_haply_messages
    PRIVATE -fsanitize=fuzzer,address,undefined -g -O1)
  target_link_options(palpate_fuzz_haply_messages
    PRIVATE -fsanitize=fuzzer,address,undefined)
  target_link_libraries(palpate_fuzz_haply_messages
    PRIVATE palpate_options nlohmann_json::nlohmann_json)
endif()
