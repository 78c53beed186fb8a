// The extension module freetalk._native: a submodule for every room.
#include <torch/extension.h>
#include <torch/version.h>

#define FREETALK_ROOM(room) void bind_##room(pybind11::module_& m);
#include "rooms.inc"
#undef FREETALK_ROOM

PYBIND11_MODULE(TORCH_EXTENSION_NAME, m) {
  m.doc() = "Native rooms of freetalk.";
  m.attr("__version__") = FREETALK_VERSION;
  m.attr("torch_version") = TORCH_VERSION;
#define FREETALK_ROOM(room)                  \
  {                                          \
    auto submodule = m.def_submodule(#room); \
    bind_##room(submodule);                  \
  }
#include "rooms.inc"
#undef FREETALK_ROOM
}
