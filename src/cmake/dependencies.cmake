# Third-party libraries of the build. The installed package looks for those of link_libraries.cmake alone.
find_package(Eigen3 3.4 REQUIRED NO_MODULE)
find_package(nlohmann_json 3 REQUIRED)
find_package(Spectra REQUIRED)
include(link_libraries)
