# Libraries that freetalk's own are linked with. Whoever links static ones needs them too, so this file
# serves the build and the installed package (freetalkConfig.cmake).
find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
pkg_check_modules(sndfile REQUIRED IMPORTED_TARGET sndfile)
pkg_check_modules(samplerate REQUIRED IMPORTED_TARGET samplerate)
find_path(DRACO_INCLUDE_DIR draco/compression/decode.h REQUIRED)
find_library(DRACO_LIBRARY draco REQUIRED)
find_path(MESHOPTIMIZER_INCLUDE_DIR meshoptimizer.h REQUIRED)
find_library(MESHOPTIMIZER_LIBRARY meshoptimizer REQUIRED)
find_path(OPENMESH_INCLUDE_DIR OpenMesh/Core/IO/MeshIO.hh REQUIRED)
find_library(OPENMESH_CORE_LIBRARY OpenMeshCore REQUIRED)
find_library(OPENMESH_TOOLS_LIBRARY OpenMeshTools REQUIRED)
if(NOT TARGET freetalk::openmesh)
  add_library(freetalk::gltf_compression INTERFACE IMPORTED)
  target_include_directories(freetalk::gltf_compression SYSTEM INTERFACE
    "${DRACO_INCLUDE_DIR}" "${MESHOPTIMIZER_INCLUDE_DIR}")
  target_link_libraries(freetalk::gltf_compression INTERFACE
    "${DRACO_LIBRARY}" "${MESHOPTIMIZER_LIBRARY}")
  add_library(freetalk::openmesh INTERFACE IMPORTED)
  target_include_directories(freetalk::openmesh SYSTEM INTERFACE "${OPENMESH_INCLUDE_DIR}")
  target_link_libraries(freetalk::openmesh INTERFACE "${OPENMESH_TOOLS_LIBRARY}" "${OPENMESH_CORE_LIBRARY}")
endif()
