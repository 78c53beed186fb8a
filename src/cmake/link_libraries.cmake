# Libraries that freetalk's own are linked with. Whoever links static ones needs them too, so this file
# serves the build and the installed package (freetalkConfig.cmake).
find_package(Threads REQUIRED)
find_package(PkgConfig REQUIRED)
pkg_check_modules(sndfile REQUIRED IMPORTED_TARGET sndfile)
pkg_check_modules(samplerate REQUIRED IMPORTED_TARGET samplerate)
find_path(OPENMESH_INCLUDE_DIR OpenMesh/Core/IO/MeshIO.hh REQUIRED)
find_library(OPENMESH_CORE_LIBRARY OpenMeshCore REQUIRED)
if(NOT TARGET freetalk::openmesh)
  add_library(freetalk::openmesh INTERFACE IMPORTED)
  target_include_directories(freetalk::openmesh SYSTEM INTERFACE "${OPENMESH_INCLUDE_DIR}")
  target_link_libraries(freetalk::openmesh INTERFACE "${OPENMESH_CORE_LIBRARY}")
endif()
