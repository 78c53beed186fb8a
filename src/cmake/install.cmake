# cmake --install: headers, one exported target a room (freetalk::<room>), the shipped weights, and what
# find_package(freetalk) needs to find torch and the other libraries just as this build did. Of header-only
# libraries a consumer needs Eigen alone, which the headers show.
include(CMakePackageConfigHelpers)
include(freetalk_torch_version)

set(FREETALK_CMAKE_DIR "${CMAKE_INSTALL_LIBDIR}/cmake/freetalk")
set(FREETALK_PRETRAINED_DIR "${CMAKE_INSTALL_DATADIR}/freetalk/pretrained")
set(FREETALK_SHARED ${BUILD_SHARED_LIBS})
set(FREETALK_BUILD_TORCH_DIR "${FREETALK_TORCH_DIR}")
freetalk_torch_version("${FREETALK_TORCH_DIR}" FREETALK_BUILD_TORCH_VERSION)

list(TRANSFORM FREETALK_ROOMS PREPEND freetalk_ OUTPUT_VARIABLE room_targets)
install(TARGETS ${room_targets} EXPORT freetalkTargets
        ARCHIVE DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT development
        LIBRARY DESTINATION "${CMAKE_INSTALL_LIBDIR}" COMPONENT development)
install(EXPORT freetalkTargets NAMESPACE freetalk:: DESTINATION "${FREETALK_CMAKE_DIR}"
        COMPONENT development)
install(DIRECTORY include/freetalk DESTINATION "${CMAKE_INSTALL_INCLUDEDIR}" COMPONENT development
        FILES_MATCHING PATTERN "*.h")
install(DIRECTORY python/freetalk/pretrained/ DESTINATION "${FREETALK_PRETRAINED_DIR}"
        COMPONENT development OPTIONAL FILES_MATCHING PATTERN "*.json" PATTERN "*.safetensors")
install(FILES LICENSE THIRD_PARTY_NOTICES.md DESTINATION "${CMAKE_INSTALL_DOCDIR}"
        COMPONENT development)

configure_package_config_file(src/cmake/freetalkConfig.cmake.in
  "${CMAKE_CURRENT_BINARY_DIR}/freetalkConfig.cmake"
  INSTALL_DESTINATION "${FREETALK_CMAKE_DIR}" PATH_VARS FREETALK_PRETRAINED_DIR
  NO_CHECK_REQUIRED_COMPONENTS_MACRO)
write_basic_package_version_file("${CMAKE_CURRENT_BINARY_DIR}/freetalkConfigVersion.cmake"
  COMPATIBILITY SameMinorVersion)
install(FILES "${CMAKE_CURRENT_BINARY_DIR}/freetalkConfig.cmake"
              "${CMAKE_CURRENT_BINARY_DIR}/freetalkConfigVersion.cmake"
              src/cmake/freetalk_torch.cmake src/cmake/freetalk_torch_version.cmake
              src/cmake/link_libraries.cmake
        DESTINATION "${FREETALK_CMAKE_DIR}" COMPONENT development)

# The wheel: configurations go beside the modules, where `freetalk train --config NAME` finds them.
if(SKBUILD)
  install(DIRECTORY configs DESTINATION freetalk COMPONENT python FILES_MATCHING PATTERN "*.yaml")
endif()
