# One library a room (freetalk::<room>), bottom to top; static, or shared with BUILD_SHARED_LIBS.
#
#   USES        rooms whose headers it includes
#   TORCH       ALL, or the units that need torch's precompiled header. Loading it costs a unit more than
#               compiling a file that knows little of torch, so the others do without it.
#   LINKS       libraries it is linked with
#   HEADERS_OF  header-only libraries seen by its own units alone; nothing a consumer has to have
include(CheckCXXSourceCompiles)
option(FREETALK_UNITY "Compile in few large units: much faster from nothing, slower after a change" OFF)

add_library(freetalk_pch OBJECT "${CMAKE_CURRENT_SOURCE_DIR}/src/cmake/pch.cpp")
target_link_libraries(freetalk_pch PUBLIC freetalk::torch Eigen3::Eigen)
target_precompile_headers(freetalk_pch PRIVATE <torch/torch.h> <Eigen/Core> <string> <vector>)
target_compile_options(freetalk_pch PRIVATE -Wall -Wextra)

function(freetalk_compile target)
  cmake_parse_arguments(ARG "" "" "HEADERS_OF" ${ARGN})
  target_include_directories(${target} PRIVATE "${CMAKE_CURRENT_SOURCE_DIR}/src")
  foreach(library IN LISTS ARG_HEADERS_OF)
    target_include_directories(${target} SYSTEM PRIVATE
      $<TARGET_PROPERTY:${library},INTERFACE_INCLUDE_DIRECTORIES>)
  endforeach()
  target_compile_features(${target} PUBLIC cxx_std_20)
  target_compile_options(${target} PRIVATE -Wall -Wextra)
  if(FREETALK_UNITY)  # to the compiler a unit's own types, seen from another unit, are a header's
    target_compile_options(${target} PRIVATE -Wno-subobject-linkage)
  endif()
  # DEFINE_SYMBOL: units are the same in static and shared libraries, so a compiler cache serves both.
  set_target_properties(${target} PROPERTIES
    UNITY_BUILD ${FREETALK_UNITY} UNITY_BUILD_BATCH_SIZE 9 DEFINE_SYMBOL "")
endfunction()

set(FREETALK_ROOMS "")
function(freetalk_add_room room)
  cmake_parse_arguments(ARG "" "" "USES;TORCH;LINKS;HEADERS_OF" ${ARGN})
  file(GLOB sources CONFIGURE_DEPENDS "${CMAKE_CURRENT_SOURCE_DIR}/src/${room}/*.cpp")
  if(NOT sources)
    return()
  endif()
  set(torch_sources ${sources})
  if(NOT ARG_TORCH STREQUAL ALL)
    list(TRANSFORM ARG_TORCH REPLACE "(.+)" "${CMAKE_CURRENT_SOURCE_DIR}/src/${room}/\\1.cpp"
         OUTPUT_VARIABLE torch_sources)
    list(REMOVE_ITEM sources ${torch_sources})
  endif()

  set(requirements freetalk::torch Eigen3::Eigen)
  foreach(used IN LISTS ARG_USES)
    if(TARGET freetalk_${used})
      list(APPEND requirements freetalk_${used})
    endif()
  endforeach()
  set(include "$<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>" $<INSTALL_INTERFACE:include>)

  if(torch_sources)
    add_library(freetalk_${room} ${torch_sources})
    target_precompile_headers(freetalk_${room} REUSE_FROM freetalk_pch)
  else()
    add_library(freetalk_${room} ${sources})
  endif()
  if(torch_sources AND NOT ARG_TORCH STREQUAL ALL)
    add_library(freetalk_${room}_plain OBJECT ${sources})
    target_include_directories(freetalk_${room}_plain PUBLIC ${include})
    target_link_libraries(freetalk_${room}_plain PRIVATE ${requirements} ${ARG_LINKS})
    freetalk_compile(freetalk_${room}_plain HEADERS_OF ${ARG_HEADERS_OF})
    target_sources(freetalk_${room} PRIVATE $<TARGET_OBJECTS:freetalk_${room}_plain>)
  endif()
  add_library(freetalk::${room} ALIAS freetalk_${room})
  # Installed shared libraries find each other beside themselves, torch where the build found it.
  set_target_properties(freetalk_${room} PROPERTIES
    EXPORT_NAME ${room} INSTALL_RPATH "$ORIGIN;${FREETALK_TORCH_DIR}/lib")
  target_include_directories(freetalk_${room} PUBLIC ${include})
  target_link_libraries(freetalk_${room} PUBLIC ${requirements} PRIVATE ${ARG_LINKS})
  freetalk_compile(freetalk_${room} HEADERS_OF ${ARG_HEADERS_OF})
  set(FREETALK_ROOMS ${FREETALK_ROOMS} ${room} PARENT_SCOPE)
endfunction()

set(json nlohmann_json::nlohmann_json)
freetalk_add_room(core TORCH module_io random safetensors scratch HEADERS_OF ${json})
freetalk_add_room(audio USES core LINKS PkgConfig::sndfile PkgConfig::samplerate)
freetalk_add_room(kernels USES core)
freetalk_add_room(mesh USES core LINKS freetalk::openmesh freetalk::gltf_compression HEADERS_OF ${json})
freetalk_add_room(geometry USES core kernels mesh TORCH combine_fields operator_cache operators
                  operators_batch poisson sparse_operator tensor_conversion LINKS Threads::Threads
                  HEADERS_OF Spectra::Spectra ${json})
freetalk_add_room(nn USES core kernels mesh geometry TORCH ALL)
freetalk_add_room(speech USES audio nn kernels core TORCH ALL HEADERS_OF ${json})
freetalk_add_room(diffusion USES core TORCH ALL)
freetalk_add_room(ats USES speech diffusion nn core TORCH ALL HEADERS_OF ${json})
freetalk_add_room(facetalk USES speech diffusion nn core TORCH ALL HEADERS_OF ${json})
freetalk_add_room(stm USES nn geometry mesh core TORCH ALL HEADERS_OF ${json})
freetalk_add_room(head USES nn geometry core TORCH ALL)
freetalk_add_room(rig USES geometry core TORCH ALL)
freetalk_add_room(metrics USES core TORCH ALL)
freetalk_add_room(animation USES audio mesh geometry core TORCH ALL HEADERS_OF ${json})
freetalk_add_room(talker USES animation rig stm head ats facetalk speech diffusion nn geometry mesh audio core
                  TORCH ALL HEADERS_OF ${json})

# core/parallel.cpp is the one unit with OpenMP; its runtime is the very one that torch uses. Where the
# compiler has none, or calls another runtime than that, loops run on one thread.
set(CMAKE_REQUIRED_DEFINITIONS -fopenmp)
set(CMAKE_REQUIRED_LIBRARIES freetalk::torch)
check_cxx_source_compiles("
#include <omp.h>
int main() {
  int threads = 0;
#pragma omp parallel reduction(+ : threads)
  threads += 1;
  return threads > omp_get_max_threads();
}" FREETALK_OPENMP)
unset(CMAKE_REQUIRED_DEFINITIONS)
unset(CMAKE_REQUIRED_LIBRARIES)
if(FREETALK_OPENMP)
  set_source_files_properties("${CMAKE_CURRENT_SOURCE_DIR}/src/core/parallel.cpp" PROPERTIES
    COMPILE_OPTIONS -fopenmp)
else()
  message(WARNING "the compiler cannot use torch's OpenMP: parallel loops run on one thread")
endif()
# Units of one instruction set each are compiled alone.
set_target_properties(freetalk_kernels PROPERTIES UNITY_BUILD OFF)
