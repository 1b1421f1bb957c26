# Installs each component with cmake --install, and packs the components into .debs with cpack:
#
#   programs  palpate          programs for a user with an arm
#   network   palpate-network  modules: bricks over HTTP, sites, HDF5
#   import    palpate-import   the importer with VTK
#   view      palpate-view     the window
#   library   libpalpate-dev   for find_package(palpate)
#   python    python3-palpate  for import palpate
#   haply     palpate-haply    the plug-in for Haply's Inverse3
#   doc       palpate-doc      the book, and sources of plug-ins to begin with
include(GNUInstallDirs)
set(here ${PROJECT_SOURCE_DIR}/scenes/package)

if(NOT PALPATE_ENGINE_ONLY)
  install(TARGETS palpate palpate-plugin
    RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT programs)
  # Only palpate runs these scripts; users do not.
  install(PROGRAMS ${PROJECT_SOURCE_DIR}/scenes/apps/cli/feel_picture.py
                   ${PROJECT_SOURCE_DIR}/scenes/apps/cli/stability_picture.py
                   ${PROJECT_SOURCE_DIR}/scenes/apps/cli/trace_picture.py
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs)
  install(FILES ${PROJECT_SOURCE_DIR}/scenes/apps/cli/picture_style.py
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs)
  install(FILES ${PROJECT_SOURCE_DIR}/devices/70-palpate-arms.rules ${here}/70-palpate-realtime.rules
    DESTINATION lib/udev/rules.d COMPONENT programs)
  install(FILES ${PROJECT_SOURCE_DIR}/scenes/scene.schema.json
                ${PROJECT_SOURCE_DIR}/devices/hid/hid_profile.schema.json
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs)
  # Patterns for users' own profiles. Their schema is one folder up.
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/devices/hid/profiles ${PROJECT_SOURCE_DIR}/scenes/examples
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs
    PATTERN prepare EXCLUDE)
  install(PROGRAMS ${PROJECT_SOURCE_DIR}/scenes/examples/prepare
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate/examples COMPONENT programs)
  # The book as Markdown, which a browser or a pager reads.
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs/
    DESTINATION ${CMAKE_INSTALL_DOCDIR}/book COMPONENT doc
    FILES_MATCHING PATTERN "*.md" PATTERN "*.png")
  install(FILES ${PROJECT_SOURCE_DIR}/CHANGELOG.md ${PROJECT_SOURCE_DIR}/README.md
    DESTINATION ${CMAKE_INSTALL_DOCDIR} COMPONENT doc)
  # A user copies and compiles these files (docs/plugins.md).
  set(plugin_sources ${PROJECT_SOURCE_DIR}/devices/plugins)
  install(FILES ${plugin_sources}/sample.c ${plugin_sources}/plugin.h ${plugin_sources}/answer.h ${plugin_sources}/newest.h
      ${plugin_sources}/openhaptics.cpp ${plugin_sources}/dhd.cpp ${plugin_sources}/nifalcon.cpp
      ${PROJECT_SOURCE_DIR}/devices/hid/known_arms.json
    DESTINATION ${CMAKE_INSTALL_DOCDIR}/plugins COMPONENT doc)
  # The programs that docs/embed.md, packages.md and notebook.md explain.
  set(shown_programs ${PROJECT_SOURCE_DIR}/tests/scenes)
  install(DIRECTORY ${shown_programs}/embed ${shown_programs}/host ${shown_programs}/host_c ${shown_programs}/host_engine
    DESTINATION ${CMAKE_INSTALL_DOCDIR}/programs COMPONENT doc
    PATTERN c_test.sh EXCLUDE PATTERN shapes EXCLUDE)
  install(FILES ${PROJECT_SOURCE_DIR}/scenes/bindings/python/session.py
                ${PROJECT_SOURCE_DIR}/scenes/apps/first_tick.cpp
    DESTINATION ${CMAKE_INSTALL_DOCDIR}/programs COMPONENT doc)
  install(CODE "set(folder \"\$ENV{DESTDIR}\${CMAKE_INSTALL_PREFIX}/${CMAKE_INSTALL_DOCDIR}\")" COMPONENT doc)
  install(SCRIPT ${here}/installed_links.cmake COMPONENT doc)
  install(FILES ${here}/palpate-limits.conf
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs)
  # A user runs this script once, to make keys for sites.
  install(PROGRAMS ${PROJECT_SOURCE_DIR}/scenes/network/sites/site_keys.sh
    DESTINATION ${CMAKE_INSTALL_DATADIR}/palpate COMPONENT programs)
  get_property(modules GLOBAL PROPERTY PALPATE_MODULES)
  if(modules)
    # Not below CMAKE_INSTALL_LIBDIR: programs look for modules where they look for plug-ins.
    install(TARGETS ${modules} LIBRARY DESTINATION lib/palpate COMPONENT network)
  endif()
  if(TARGET palpate_plugin_haply)
    install(TARGETS palpate_plugin_haply LIBRARY DESTINATION lib/palpate/plugins COMPONENT haply)
  endif()
  install(TARGETS palpate-import-light
    RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT programs)
  if(PALPATE_VTK)
    install(TARGETS palpate-import
      RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT import)
  endif()
  if(TARGET palpate-view)
    install(TARGETS palpate-view
      RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR} COMPONENT view)
  endif()
  if(PALPATE_PYTHON)
    # Debian's folder for the modules of packages, if the prefix is the system's.
    set(PALPATE_PYTHON_FOLDER lib/python3/dist-packages
        CACHE STRING "Folder of the Python module, below the prefix")
    install(TARGETS palpate_python
      LIBRARY DESTINATION ${PALPATE_PYTHON_FOLDER} COMPONENT python)
  endif()

  # A manual page for each verb is generated from the programs' help.
  set(speakers palpate palpate-import-light)
  if(PALPATE_VTK)
    list(APPEND speakers palpate-import)
  endif()
  find_program(PALPATE_HELP2MAN help2man)
  if(PALPATE_HELP2MAN AND NOT PALPATE_SANITIZE)
    set(pages ${PROJECT_BINARY_DIR}/man)
    set(stamp ${pages}/stamp)
    add_custom_command(OUTPUT ${stamp}
      COMMAND ${here}/man_pages.sh $<TARGET_FILE:palpate> ${pages} ${PALPATE_HELP2MAN}
      COMMAND ${CMAKE_COMMAND} -E touch ${stamp}
      DEPENDS ${speakers} ${here}/man_pages.sh
      COMMENT "Manual pages")
    add_custom_target(palpate_man ALL DEPENDS ${stamp})
    install(DIRECTORY ${pages}/ DESTINATION ${CMAKE_INSTALL_MANDIR}/man1 COMPONENT programs
      FILES_MATCHING PATTERN "*.1")
  endif()
endif()

# The libraries that exist in this build. With the engine alone: those that need only Eigen.
set(libraries "")
foreach(library analytic devices engine guardian hid json modules openvdb options plugins record
        samplers scenes)
  if(TARGET palpate_${library})
    set_target_properties(palpate_${library} PROPERTIES EXPORT_NAME ${library})
    list(APPEND libraries palpate_${library})
  endif()
endforeach()
set(config ${CMAKE_INSTALL_LIBDIR}/cmake/palpate)
install(TARGETS ${libraries} EXPORT palpate
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT library)
install(EXPORT palpate NAMESPACE palpate:: FILE palpate-targets.cmake
  DESTINATION ${config} COMPONENT library)
if(NOT PALPATE_ENGINE_ONLY)
  set_target_properties(palpate_c PROPERTIES EXPORT_NAME c)
  install(TARGETS palpate_c EXPORT palpate-c
    LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR} COMPONENT programs NAMELINK_COMPONENT library)
  install(EXPORT palpate-c NAMESPACE palpate:: FILE palpate-c-targets.cmake
    DESTINATION ${config} COMPONENT library)
endif()
include(CMakePackageConfigHelpers)
configure_file(${here}/palpate-config.cmake.in ${PALPATE_GENERATED}/palpate-config.cmake @ONLY)
write_basic_package_version_file(${PALPATE_GENERATED}/palpate-config-version.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PALPATE_GENERATED}/palpate-config.cmake
              ${PALPATE_GENERATED}/palpate-config-version.cmake
  DESTINATION ${config} COMPONENT library)
# Public headers are those that do not begin with "Private to". With the engine alone: those that do not include the
# rest.
foreach(folder
    engine engine/balance engine/field engine/loop engine/modes engine/safety engine/scene engine/tick
    samplers samplers/grid samplers/time samplers/bricks
    devices devices/arm devices/hid devices/json devices/plugins devices/recording devices/simulated
    scenes scenes/bindings/c scenes/guess scenes/library)
  file(GLOB headers CONFIGURE_DEPENDS ${PROJECT_SOURCE_DIR}/${folder}/*.h)
  if(PALPATE_ENGINE_ONLY AND folder STREQUAL samplers/grid)
    set(headers ${PROJECT_SOURCE_DIR}/samplers/grid/analytic_field.h)
  elseif(PALPATE_ENGINE_ONLY AND folder MATCHES "^(samplers|scenes)")
    set(headers "")
  endif()
  foreach(header ${headers})
    file(STRINGS ${header} first LIMIT_COUNT 1)
    if(NOT first MATCHES "^/// Private to")
      install(FILES ${header} DESTINATION include/palpate/${folder} COMPONENT library)
    endif()
  endforeach()
endforeach()

if(PALPATE_ENGINE_ONLY)
  return()
endif()

# palpate_package(COMPONENT PACKAGE)
# Packs a component, with its copyright.
function(palpate_package component package)
  string(TOUPPER ${component} upper)
  set(CPACK_DEBIAN_${upper}_PACKAGE_NAME ${package} PARENT_SCOPE)
  set(CPACK_COMPONENTS_ALL ${CPACK_COMPONENTS_ALL} ${component} PARENT_SCOPE)
  install(FILES ${here}/copyright
    DESTINATION ${CMAKE_INSTALL_DATADIR}/doc/${package} COMPONENT ${component})
endfunction()

set(CPACK_GENERATOR DEB)
set(CPACK_PACKAGE_CONTACT "the palpate authors <palpate@localhost>")
set(CPACK_PACKAGE_DESCRIPTION_SUMMARY "Haptics engine for sparse volumes: feel a CT, an MRI, a flow")
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
set(CPACK_STRIP_FILES ON)
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
palpate_package(programs palpate)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_DEPENDS adduser)
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_RECOMMENDS
    "palpate-import, palpate-network, palpate-view, python3-matplotlib")
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_SUGGESTS "librados2, palpate-doc, palpate-haply")
set(CPACK_DEBIAN_PROGRAMS_PACKAGE_CONTROL_EXTRA
    ${here}/postinst ${here}/postrm ${here}/triggers)
palpate_package(library libpalpate-dev)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_SECTION libdevel)
set(CPACK_DEBIAN_LIBRARY_PACKAGE_DEPENDS "libeigen3-dev (>= 3.4)")
# Required by palpate::samplers, ::hid and ::scenes; the engine needs only Eigen.
set(CPACK_DEBIAN_LIBRARY_PACKAGE_RECOMMENDS "libopenvdb-dev, libtbb-dev, libfmt-dev, \
nlohmann-json3-dev, libhidapi-dev, libboost-iostreams-dev, zlib1g-dev, \
libzstd-dev, palpate-network")
if(modules)
  palpate_package(network palpate-network)
  set(CPACK_DEBIAN_NETWORK_PACKAGE_DEPENDS "palpate (= ${PROJECT_VERSION})")
  set(CPACK_DEBIAN_NETWORK_PACKAGE_SUGGESTS "ca-certificates, openssl")
endif()
if(PALPATE_VTK)
  palpate_package(import palpate-import)
  set(CPACK_DEBIAN_IMPORT_PACKAGE_DEPENDS "palpate (= ${PROJECT_VERSION})")
endif()
if(TARGET palpate-view)
  palpate_package(view palpate-view)
  set(CPACK_DEBIAN_VIEW_PACKAGE_DEPENDS "palpate (= ${PROJECT_VERSION})")
  # Needed for pictures on a machine without a display.
  set(CPACK_DEBIAN_VIEW_PACKAGE_RECOMMENDS "libgl1-mesa-dri, xvfb")
endif()
if(PALPATE_PYTHON)
  palpate_package(python python3-palpate)
  set(CPACK_DEBIAN_PYTHON_PACKAGE_SECTION python)
  # The module works with one version of Python's binary interface.
  math(EXPR next "${Python_VERSION_MINOR} + 1")
  set(CPACK_DEBIAN_PYTHON_PACKAGE_DEPENDS "python3 (>= 3.${Python_VERSION_MINOR}), \
python3 (<< 3.${next}), python3-numpy")
  set(CPACK_DEBIAN_PYTHON_PACKAGE_RECOMMENDS "palpate-network, python3-vtk9")
endif()
if(TARGET palpate_plugin_haply)
  palpate_package(haply palpate-haply)
  set(CPACK_DEBIAN_HAPLY_PACKAGE_DEPENDS "palpate (= ${PROJECT_VERSION})")
endif()
palpate_package(doc palpate-doc)
set(CPACK_DEBIAN_DOC_PACKAGE_SECTION doc)
set(CPACK_DEBIAN_DOC_PACKAGE_ARCHITECTURE all)
set(CPACK_COMPONENT_PROGRAMS_DESCRIPTION "\
Feels .vdb volumes with a force-feedback arm or a simulated hand. Contains the program, its importer \
of NIfTI, NRRD, MetaImage and raw values, its manual, and the rules that let a user open an arm.")
set(CPACK_COMPONENT_NETWORK_DESCRIPTION "\
Lets palpate read bricks from web servers, connect the hands of several sites by DDS, and convert \
recordings to HDF5.")
set(CPACK_COMPONENT_IMPORT_DESCRIPTION "\
Lets palpate import read the formats of VTK (DICOM, meshes of solvers, VTK files), and netCDF of \
weather and oceans.")
set(CPACK_COMPONENT_VIEW_DESCRIPTION "\
A window for palpate view: shows the volumes, the hand, its forces and the reasons for them.")
set(CPACK_COMPONENT_LIBRARY_DESCRIPTION "\
Static libraries and headers for find_package(palpate).")
set(CPACK_COMPONENT_PYTHON_DESCRIPTION "\
Volumes of numpy arrays, scenes and hands for scripts.")
set(CPACK_COMPONENT_HAPLY_DESCRIPTION "\
Lets palpate drive Haply's Inverse3 through Haply's Inverse Service.")
set(CPACK_COMPONENT_DOC_DESCRIPTION "\
The book of palpate, and the sources of plug-ins and programs that it explains.")
include(CPack)
