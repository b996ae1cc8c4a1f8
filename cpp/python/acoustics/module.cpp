// sonar_sim._core: the simulator's kernels. Their documentation is in _core.pyi.
#include <pybind11/pybind11.h>

#include "previewing.hpp"
#include "receiving.hpp"
#include "scatter.hpp"
#include "tracing.hpp"

PYBIND11_MODULE(_core, module) {
  module.doc() = "The C++ kernels of the sonar simulator.";
  bind_previewing(module);
  bind_receiving(module);
  bind_scatter(module);
  bind_tracing(module);
}
