// The IWLO rule.
#include "mapperd/map/iwlo.hpp"

#include <pybind11/pybind11.h>

#include <algorithm>

#include "bindings.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

IwloParams iwlo_params(double L_occ, double L_free, double L_min, double L_max, double sharpness,
                       double decay_rate, double min_alpha, double intensity_threshold,
                       double intensity_max, bool adaptive_update, double adaptive_threshold,
                       double adaptive_max_ratio, double adaptive_min_ratio, bool protect_occupied,
                       double prior) {
  const IwloParams params{L_occ,
                          L_free,
                          L_min,
                          L_max,
                          sharpness,
                          decay_rate,
                          min_alpha,
                          intensity_threshold,
                          intensity_max,
                          adaptive_update,
                          adaptive_threshold,
                          adaptive_max_ratio,
                          adaptive_min_ratio,
                          protect_occupied,
                          prior};
  const IwloRule checked_rule(params);
  return checked_rule.params();
}

py::tuple update(const IwloParams& params, double log_odds, int count, bool occupied, double weight,
                 double factor) {
  const IwloRule rule(params);
  auto seen = static_cast<std::uint16_t>(std::clamp<int>(count, 0, rule.settled_count()));
  const double step =
      occupied ? rule.occupied_step(log_odds, seen, weight) : rule.free_step(log_odds, seen);
  const double updated = std::clamp(log_odds + factor * step, params.L_min, params.L_max);
  if (seen < rule.settled_count()) ++seen;
  return py::make_tuple(updated, static_cast<int>(seen));
}

}  // namespace

void bind_iwlo(py::module_& module) {
  const IwloParams defaults;
  py::class_<IwloParams>(module, "IwloParams")
      .def(py::init(&iwlo_params), py::kw_only(), "L_occ"_a = defaults.L_occ,
           "L_free"_a = defaults.L_free, "L_min"_a = defaults.L_min, "L_max"_a = defaults.L_max,
           "sharpness"_a = defaults.sharpness, "decay_rate"_a = defaults.decay_rate,
           "min_alpha"_a = defaults.min_alpha,
           "intensity_threshold"_a = defaults.intensity_threshold,
           "intensity_max"_a = defaults.intensity_max,
           "adaptive_update"_a = defaults.adaptive_update,
           "adaptive_threshold"_a = defaults.adaptive_threshold,
           "adaptive_max_ratio"_a = defaults.adaptive_max_ratio,
           "adaptive_min_ratio"_a = defaults.adaptive_min_ratio,
           "protect_occupied"_a = defaults.protect_occupied, "prior"_a = defaults.prior)
      .def_readonly("prior", &IwloParams::prior)
      .def(
          "occupied_weight",
          [](const IwloParams& params, double intensity) {
            return IwloRule(params).occupied_weight(intensity);
          },
          "intensity"_a)
      .def("update", &update, "log_odds"_a, "count"_a, py::kw_only(), "occupied"_a,
           "weight"_a = 1.0, "factor"_a = 1.0);
}

}  // namespace mapperd::python
