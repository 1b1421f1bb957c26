# The plug-in for Haply's Inverse3: optional, built if libwebsockets is installed.
find_path(PALPATE_WEBSOCKETS_HEADERS libwebsockets.h)
find_library(PALPATE_WEBSOCKETS_LIBRARY websockets)
set(PALPATE_HAPLY AUTO CACHE STRING
    "Build the plug-in for Haply's Inverse3 (AUTO: where libwebsockets is)")
if(PALPATE_HAPLY STREQUAL "AUTO")
  set(PALPATE_HAPLY OFF)
  if(PALPATE_WEBSOCKETS_HEADERS AND PALPATE_WEBSOCKETS_LIBRARY)
    set(PALPATE_HAPLY ON)
  endif()
endif()
if(NOT PALPATE_HAPLY)
  return()
endif()
if(NOT PALPATE_WEBSOCKETS_HEADERS OR NOT PALPATE_WEBSOCKETS_LIBRARY)
  message(FATAL_ERROR "PALPATE_HAPLY needs libwebsockets: install libwebsockets-dev")
endif()

# The messages alone, without a network: tests and fuzzers use them.
add_library(palpate_haply_messages STATIC ${CMAKE_CURRENT_LIST_DIR}/haply_messages.cpp)
target_include_directories(palpate_haply_messages PUBLIC ${PALPATE_INCLUDE})
target_link_libraries(palpate_haply_messages
  PRIVATE palpate_options nlohmann_json::nlohmann_json)

# haply.so exports one symbol.
add_library(palpate_plugin_haply MODULE
  ${CMAKE_CURRENT_LIST_DIR}/haply.cpp ${CMAKE_CURRENT_LIST_DIR}/haply_service.cpp)
target_include_directories(palpate_plugin_haply PRIVATE ${PALPATE_INCLUDE})
target_include_directories(palpate_plugin_haply SYSTEM PRIVATE ${PALPATE_WEBSOCKETS_HEADERS})
target_link_libraries(palpate_plugin_haply
  PRIVATE palpate_haply_messages palpate_options Threads::Threads ${PALPATE_WEBSOCKETS_LIBRARY})
set_target_properties(palpate_haply_messages palpate_plugin_haply PROPERTIES
  CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
# clang's tools read the compile commands of a build with stubs and do not know -fno-gnu-unique.
if(CMAKE_CXX_COMPILER_ID STREQUAL "GNU" AND NOT PALPATE_PLUGIN_STUBS)
  # Without it, symbols that the standard library shares between libraries would also be exported.
  target_compile_options(palpate_haply_messages PRIVATE -fno-gnu-unique)
  target_compile_options(palpate_plugin_haply PRIVATE -fno-gnu-unique)
endif()
set_target_properties(palpate_plugin_haply PROPERTIES
  PREFIX "" OUTPUT_NAME haply LIBRARY_OUTPUT_DIRECTORY ${PROJECT_BINARY_DIR}/plugins)
