# The plug-in for Haply's Inverse3: optional, built where libwebsockets is.
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

# Messages alone, as tests and fuzzers have them: no network.
add_library(palpate_haply_messages STATIC ${CMAKE_CURRENT_LIST_DIR}/haply_messages.cpp)
target_include_directories(palpate_haply_messages PUBLIC ${PALPATE_INCLUDE})
target_link_libraries(palpate_haply_messages
  PRIVATE palpate_options nlohmann_json::nlohmann_json)

set_target_properties(palpate_haply_messages PROPERTIES
  CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
