# Third-party libraries of the build. The installed package looks for those of link_libraries.cmake alone.
include(CMakeFindDependencyMacro)  # some builds of Spectra use it without including it
include(link_libraries)
find_package(Eigen3 3.4 REQUIRED NO_MODULE)
find_package(nlohmann_json 3 REQUIRED)
find_package(Spectra REQUIRED)
