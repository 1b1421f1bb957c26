# Counts how often each part of the tick runs. Builds palpate with counters, and runs some scenes with this build.
# Stores the counts in COUNTS, where a build with PALPATE_TRAINED looks for them.
#
#     cmake -D SOURCE=... -D TRAINING=... -D COUNTS=... -D GENERATOR=... -D COMPILER=... -P train.cmake
cmake_minimum_required(VERSION 3.22)

function(run)
  execute_process(COMMAND ${ARGN} COMMAND_ERROR_IS_FATAL ANY)
endfunction()

run(${CMAKE_COMMAND} -S ${SOURCE} -B ${TRAINING} -G ${GENERATOR} -D CMAKE_BUILD_TYPE=Release
  -D CMAKE_CXX_COMPILER=${COMPILER} -D PALPATE_COUNTING=ON -D PALPATE_TESTS=OFF
  -D PALPATE_BENCH=OFF -D PALPATE_VTK=OFF)
run(${CMAKE_COMMAND} --build ${TRAINING} --target palpate)

# A surface, a wall with friction, a stream, directions, and two objects that overlap. The compiler cache may provide
# objects that were compiled in another folder, so GCOV_PREFIX puts all counts below one folder.
set(scenes ${TRAINING}/scenes)
set(counted ${TRAINING}/counted)
file(REMOVE_RECURSE ${counted} ${COUNTS})
file(MAKE_DIRECTORY ${scenes} ${COUNTS})
set(palpate ${CMAKE_COMMAND} -E env GCOV_PREFIX=${counted} ${TRAINING}/bin/palpate)
foreach(volume IN ITEMS wind-tunnel fibres two-bodies)
  run(${palpate} make ${volume} ${scenes}/${volume}.vdb)
endforeach()
file(WRITE ${scenes}/rough.json [=[{
  "palpate": 1,
  "coupling": {"stiffness": 500, "damping": 0.5},
  "volumes": {"bowl": {"file": "two-bodies.vdb", "grid": "bowl", "place": {"fit": 0.1}},
              "cloud": {"file": "two-bodies.vdb", "grid": "cloud", "place": {"like": "bowl"}}},
  "modes": [{"mode": "isosurface", "of": "bowl", "value": 0, "solid": "below", "strength": 3,
             "friction": 0.3},
            {"mode": "viscosity", "of": "cloud", "strength": {"piecewise": [[0, 0], [1, 0.5]]}}]
}
]=])
foreach(scene IN ITEMS wind-tunnel.vdb fibres.vdb two-bodies.vdb rough.json)
  run(${palpate} feel ${scenes}/${scene} --seconds 20)
endforeach()

file(GLOB_RECURSE counts RELATIVE ${counted} ${counted}/*.gcda)
if(NOT counts)
  message(FATAL_ERROR "the training has left no counts below ${counted}: remove ${TRAINING}")
endif()
foreach(count IN LISTS counts)
  # The name that -fprofile-use looks for: relative to the build folder, with # for /.
  string(REGEX REPLACE "^.*/training/" "" name ${count})
  string(REPLACE "/" "#" name ${name})
  file(COPY_FILE ${counted}/${count} ${COUNTS}/${name})
endforeach()
file(WRITE ${COUNTS}/done "")
