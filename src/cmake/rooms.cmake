# One static library a room (freetalk::<room>), bottom to top. PUBLIC: rooms whose headers it includes.
add_library(freetalk_pch OBJECT "${CMAKE_CURRENT_SOURCE_DIR}/src/cmake/pch.cpp")
target_link_libraries(freetalk_pch PUBLIC freetalk::torch Eigen3::Eigen)
target_precompile_headers(freetalk_pch PRIVATE <torch/torch.h> <Eigen/Core> <string> <vector>)
target_compile_options(freetalk_pch PRIVATE -Wall -Wextra)

set(FREETALK_ROOMS "")
function(freetalk_add_room room)
  cmake_parse_arguments(ARG "" "" "USES;PRIVATE_LIBS" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/src/${room}/*.cpp")
  if(NOT sources)
    return()
  endif()
  add_library(freetalk_${room} STATIC ${sources})
  add_library(freetalk::${room} ALIAS freetalk_${room})
  set_target_properties(freetalk_${room} PROPERTIES EXPORT_NAME ${room})
  target_include_directories(freetalk_${room}
    PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:include>
    PRIVATE "${CMAKE_CURRENT_SOURCE_DIR}/src")
  target_compile_features(freetalk_${room} PUBLIC cxx_std_20)
  target_compile_options(freetalk_${room} PRIVATE -Wall -Wextra)
  target_precompile_headers(freetalk_${room} REUSE_FROM freetalk_pch)
  target_link_libraries(freetalk_${room} PUBLIC freetalk::torch Eigen3::Eigen)
  foreach(used IN LISTS ARG_USES)
    if(TARGET freetalk_${used})
      target_link_libraries(freetalk_${room} PUBLIC freetalk_${used})
    endif()
  endforeach()
  target_link_libraries(freetalk_${room} PRIVATE ${ARG_PRIVATE_LIBS})
  set(FREETALK_ROOMS ${FREETALK_ROOMS} ${room} PARENT_SCOPE)
endfunction()

freetalk_add_room(core PRIVATE_LIBS nlohmann_json::nlohmann_json)
freetalk_add_room(audio USES core PRIVATE_LIBS PkgConfig::sndfile PkgConfig::samplerate)
freetalk_add_room(kernels USES core)
freetalk_add_room(mesh USES core PRIVATE_LIBS freetalk::openmesh nlohmann_json::nlohmann_json)
freetalk_add_room(geometry USES core kernels mesh PRIVATE_LIBS Spectra::Spectra Threads::Threads
                  nlohmann_json::nlohmann_json)
freetalk_add_room(nn USES core kernels mesh geometry)
freetalk_add_room(speech USES audio nn kernels core PRIVATE_LIBS nlohmann_json::nlohmann_json)
freetalk_add_room(diffusion USES core)
freetalk_add_room(ats USES speech diffusion nn core PRIVATE_LIBS nlohmann_json::nlohmann_json)
freetalk_add_room(stm USES nn geometry core PRIVATE_LIBS nlohmann_json::nlohmann_json)
freetalk_add_room(metrics USES core)
freetalk_add_room(animation USES audio mesh geometry core PRIVATE_LIBS nlohmann_json::nlohmann_json)
freetalk_add_room(talker USES animation stm ats speech diffusion nn geometry mesh audio core
                  PRIVATE_LIBS nlohmann_json::nlohmann_json)

# core/parallel.cpp is the one unit with OpenMP; its runtime is the very one that torch uses.
set_source_files_properties("${CMAKE_CURRENT_SOURCE_DIR}/src/core/parallel.cpp" PROPERTIES
  COMPILE_OPTIONS -fopenmp SKIP_PRECOMPILE_HEADERS ON SKIP_UNITY_BUILD_INCLUSION ON)
