# Adds the module FOLDER/NAME.so, which exports one symbol and does not link palpate.
function(palpate_plugin target name source folder)
  add_library(${target} MODULE ${source})
  set_target_properties(${target} PROPERTIES
    PREFIX "" OUTPUT_NAME ${name} SUFFIX .so LIBRARY_OUTPUT_DIRECTORY ${folder}
    C_STANDARD 99 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF
    C_VISIBILITY_PRESET hidden CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON)
  target_include_directories(${target} PRIVATE ${PROJECT_BINARY_DIR}/include)
  target_compile_options(${target} PRIVATE -Wall -Wextra -Wpedantic -Wshadow -Wconversion)
endfunction()

# Builds against the makers' libraries, if a lab has them. Tests build the same sources against stubs.
option(PALPATE_PLUGIN_SDKS
       "Build plug-ins for the SDKs in PALPATE_OPENHAPTICS, PALPATE_DHD, PALPATE_NIFALCON" OFF)
foreach(name OPENHAPTICS DHD NIFALCON)
  set(PALPATE_${name} "" CACHE PATH "Folder of that SDK, with include/ and lib/")
endforeach()
# Builds NAME.cpp against the SDK that has HEADER and LIBRARY. A static LIBRARY also needs the libraries that follow.
function(palpate_sdk_plugin name header library)
  string(TOUPPER ${name} key)
  if(NOT PALPATE_${key})
    return()
  endif()
  find_path(PALPATE_${key}_HEADERS ${header} PATHS ${PALPATE_${key}} PATH_SUFFIXES include
            NO_DEFAULT_PATH)
  find_library(PALPATE_${key}_LIBRARY ${library} PATHS ${PALPATE_${key}}
               PATH_SUFFIXES lib lib64 lib/release/lin-x86_64-gcc NO_DEFAULT_PATH)
  if(NOT PALPATE_${key}_HEADERS OR NOT PALPATE_${key}_LIBRARY)
    message(FATAL_ERROR "PALPATE_${key}=${PALPATE_${key}} has no include/${header} or no "
                        "lib/lib${library}.so: give the folder that the SDK was unpacked in")
  endif()
  palpate_plugin(palpate_plugin_${name} ${name}
                 ${CMAKE_CURRENT_FUNCTION_LIST_DIR}/${name}.cpp
                 ${PROJECT_BINARY_DIR}/lib/palpate/plugins)
  target_include_directories(palpate_plugin_${name} SYSTEM PRIVATE ${PALPATE_${key}_HEADERS})
  target_link_libraries(palpate_plugin_${name} PRIVATE ${PALPATE_${key}_LIBRARY} pthread)
  if(PALPATE_${key}_LIBRARY MATCHES "\\.a$")
    target_link_libraries(palpate_plugin_${name} PRIVATE ${ARGN})
  endif()
endfunction()
if(PALPATE_PLUGIN_SDKS)
  palpate_sdk_plugin(openhaptics HD/hd.h HD)
  palpate_sdk_plugin(dhd dhdc.h dhd usb-1.0 rt)
  palpate_sdk_plugin(nifalcon falcon/core/FalconDevice.h nifalcon)
endif()
