# Imported target freetalk::torch: the headers and libraries of an installed torch wheel or LibTorch.
#
# find_package(Torch) of a CUDA wheel stops where no CUDA toolkit is installed; freetalk is plain C++ that
# needs none, so this target points at the include and lib folders itself. Set FREETALK_TORCH_DIR to a
# LibTorch (or the folder `python -c "import torch; print(torch.__path__[0])"` prints) to choose one.
if(TARGET freetalk::torch)
  return()
endif()

if(NOT FREETALK_TORCH_DIR)
  find_package(Python COMPONENTS Interpreter REQUIRED)
  execute_process(
    COMMAND "${Python_EXECUTABLE}" -c
            "import importlib.util as u, os; print(os.path.dirname(u.find_spec('torch').origin))"
    OUTPUT_VARIABLE FREETALK_TORCH_DIR
    OUTPUT_STRIP_TRAILING_WHITESPACE
    RESULT_VARIABLE _freetalk_torch_result
    ERROR_QUIET)
  if(NOT _freetalk_torch_result EQUAL 0)
    message(FATAL_ERROR "torch was not found by ${Python_EXECUTABLE}: install it (pip install torch) "
                        "or pass -DFREETALK_TORCH_DIR=/path/to/libtorch")
  endif()
endif()

find_library(FREETALK_TORCH_LIBRARY torch PATHS "${FREETALK_TORCH_DIR}/lib" NO_DEFAULT_PATH REQUIRED)
find_library(FREETALK_TORCH_CPU_LIBRARY torch_cpu PATHS "${FREETALK_TORCH_DIR}/lib" NO_DEFAULT_PATH REQUIRED)
find_library(FREETALK_C10_LIBRARY c10 PATHS "${FREETALK_TORCH_DIR}/lib" NO_DEFAULT_PATH REQUIRED)
find_library(FREETALK_TORCH_PYTHON_LIBRARY torch_python PATHS "${FREETALK_TORCH_DIR}/lib" NO_DEFAULT_PATH)
mark_as_advanced(FREETALK_TORCH_LIBRARY FREETALK_TORCH_CPU_LIBRARY FREETALK_C10_LIBRARY
                 FREETALK_TORCH_PYTHON_LIBRARY)

add_library(freetalk::torch INTERFACE IMPORTED)
target_include_directories(freetalk::torch SYSTEM INTERFACE
  "${FREETALK_TORCH_DIR}/include" "${FREETALK_TORCH_DIR}/include/torch/csrc/api/include")
# libtorch registers its kernels when it is loaded, so it must stay linked though no symbol of it is named.
target_link_libraries(freetalk::torch INTERFACE
  "-Wl,--no-as-needed" "${FREETALK_TORCH_LIBRARY}" "${FREETALK_TORCH_CPU_LIBRARY}"
  "${FREETALK_C10_LIBRARY}" "-Wl,--as-needed")

# The OpenMP runtime of torch itself: a process with two of them runs twice the threads.
file(GLOB _freetalk_openmp "${FREETALK_TORCH_DIR}/lib/libgomp*.so*" "${FREETALK_TORCH_DIR}/lib/libiomp5.so*"
     "${FREETALK_TORCH_DIR}/../torch.libs/libgomp*.so*")
if(_freetalk_openmp)
  list(GET _freetalk_openmp 0 _freetalk_openmp)
  target_link_libraries(freetalk::torch INTERFACE "${_freetalk_openmp}")
else()
  find_package(OpenMP COMPONENTS CXX)
  if(OpenMP_CXX_FOUND)
    target_link_libraries(freetalk::torch INTERFACE OpenMP::OpenMP_CXX)
  endif()
endif()
