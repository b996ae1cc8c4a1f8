// The particle filter, its estimates and its parts.
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <array>
#include <cstdint>
#include <memory>
#include <tuple>
#include <utility>

#include "bindings.hpp"
#include "localization_types.hpp"
#include "mapperd/localization/gaussian.hpp"
#include "mapperd/localization/particle_filter.hpp"

namespace mapperd::python {
namespace {

using namespace pybind11::literals;

loc::Scheme scheme_of(const std::string& name) {
  if (name == "low_variance") return loc::Scheme::kLowVariance;
  if (name == "multinomial") return loc::Scheme::kMultinomial;
  throw std::invalid_argument("resampling must be low_variance or multinomial, not " + name);
}

loc::FitKind kind_of(const std::string& name) {
  if (name == "cube_sum_from_one") return loc::FitKind::kCubeSumFromOne;
  if (name == "cube_sum") return loc::FitKind::kCubeSum;
  if (name == "product") return loc::FitKind::kProduct;
  throw std::invalid_argument("kind must be cube_sum_from_one, cube_sum or product, not " + name);
}

loc::FilterParams rule_of(std::size_t min_particles, std::size_t max_particles, double kld_error,
                          double kld_quantile, double bucket_x_m, double bucket_y_m,
                          double bucket_yaw_rad, const std::string& resampling, double alpha_slow,
                          double alpha_fast, std::size_t resample_interval, bool selective,
                          double max_step_m, double least_effective_share, double draw_exponent) {
  const loc::KldParams kld{kld_error, kld_quantile, bucket_x_m, bucket_y_m, bucket_yaw_rad};
  const loc::FilterParams rule{{min_particles, max_particles, kld, scheme_of(resampling)},
                               alpha_slow,
                               alpha_fast,
                               resample_interval,
                               selective,
                               max_step_m,
                               least_effective_share,
                               draw_exponent};
  loc::check_filter_rule(rule);
  return rule;
}

// Python holds filter and map during a call. No other thread may use the filter then.
template <typename... Arguments>
loc::Weighed weighed(loc::ParticleFilter& filter, const Arguments&... arguments) {
  const py::gil_scoped_release release;
  return filter.weigh(arguments...);
}

loc::Alphas alphas_of(const py::object& object) {
  const auto values = vector_of<double>(object, "alphas");
  loc::Alphas alphas{};
  if (values.size() != alphas.size()) {
    throw std::invalid_argument("alphas must have shape (5,)");
  }
  std::copy(values.begin(), values.end(), alphas.begin());
  return alphas;
}

bool predict(loc::ParticleFilter& filter, const py::object& before, const py::object& now,
             const std::string& model, const py::object& alphas, double floor_xy_m,
             double floor_yaw_rad) {
  const loc::Pose2 from = pose_of(before, "before");
  const loc::Pose2 to = pose_of(now, "now");
  const loc::MotionModel kind = motion_of(model);
  const loc::Alphas noise = alphas_of(alphas);
  const py::gil_scoped_release release;
  return filter.predict(from, to, kind, noise, {floor_xy_m, floor_yaw_rad});
}

void start_with(loc::ParticleFilter& filter, const py::object& poses, const py::object& weights) {
  loc::Particles particles = particles_of(poses, "poses");
  if (!weights.is_none()) {
    const auto given = vector_of<double>(weights, "weights");
    if (given.size() != particles.size()) {
      throw std::invalid_argument("each particle needs a weight");
    }
    for (std::size_t i = 0; i < given.size(); ++i) {
      if (!(given[i] >= 0.0)) throw std::invalid_argument("weights must not be negative");
      particles.log_weight[i] = std::log(given[i]);
    }
  }
  filter.start_with(std::move(particles));
}

py::dict counts_of(const loc::ParticleFilter& filter) {
  const loc::FilterCounts& c = filter.counts();
  return py::dict("updates"_a = c.updates, "resamplings"_a = c.resamplings,
                  "injected_particles"_a = c.injected_particles,
                  "refused_steps"_a = c.refused_steps, "empty_scans"_a = c.empty_scans,
                  "uninformative_scans"_a = c.uninformative_scans,
                  "not_a_number"_a = c.not_a_number);
}

// Poses, logarithms of the weights, whole numbers, averages.
py::tuple state_of(const loc::ParticleFilter& filter) {
  const loc::FilterState state = filter.state();
  const loc::FilterCounts& c = state.counts;
  const auto numbers = py::make_tuple(state.seed, state.step, state.updates_since_start, c.updates,
                                      c.resamplings, c.injected_particles, c.refused_steps,
                                      c.empty_scans, c.uninformative_scans, c.not_a_number);
  const auto averages =
      py::make_tuple(state.averages.slow, state.averages.fast, state.averages.begun);
  return py::make_tuple(poses_of(state.particles), array_of(state.particles.log_weight), numbers,
                        averages);
}

void restore(loc::ParticleFilter& filter, const py::object& poses, const py::object& log_weights,
             const std::array<std::uint64_t, 10>& numbers,
             const std::tuple<double, double, bool>& averages) {
  loc::FilterState state;
  state.particles = particles_of(poses, "poses");
  const auto logs = vector_of<double>(log_weights, "log_weights");
  if (logs.size() != state.particles.size()) {
    throw std::invalid_argument("each particle needs a weight");
  }
  state.particles.log_weight = logs;
  state.seed = numbers[0];
  state.step = numbers[1];
  state.updates_since_start = numbers[2];
  state.counts = {numbers[3], numbers[4], numbers[5], numbers[6],
                  numbers[7], numbers[8], numbers[9]};
  state.averages = {std::get<0>(averages), std::get<1>(averages), std::get<2>(averages)};
  filter.restore(std::move(state));
}

py::tuple modes_of(const loc::ParticleFilter& filter, double bucket_xy_m, double bucket_yaw_rad) {
  const loc::ClusterParams rule{bucket_xy_m, bucket_yaw_rad, loc::ClusterParams{}.cap_percentile};
  loc::Clusters clusters;
  loc::Estimate best;
  {
    const py::gil_scoped_release release;
    clusters = filter.clusters(rule);
    best = loc::best_estimate(filter.particles(), filter.weights(), clusters);
  }
  const std::vector<std::int64_t> label(clusters.label.begin(), clusters.label.end());
  return py::make_tuple(best, array_of(clusters.mass), array_of(label));
}

loc::Estimate estimate_of_poses(const py::object& poses, const py::object& weights) {
  const loc::Particles particles = particles_of(poses, "poses");
  const auto weight = vector_of<double>(weights, "weights");
  if (weight.size() != particles.size()) throw std::invalid_argument("each pose needs a weight");
  return loc::estimate_of(particles, weight);
}

py::array_t<double> root_of(const py::object& covariance) {
  return array_of(loc::square_root_of(matrix_of(covariance, "covariance")));
}

void bind_results(py::module_& module) {
  py::class_<loc::Estimate>(module, "MclEstimate")
      .def_property_readonly("mean", [](const loc::Estimate& e) { return array_of(e.mean); })
      .def_property_readonly("covariance",
                             [](const loc::Estimate& e) { return array_of(e.covariance); })
      .def_readonly("mass", &loc::Estimate::mass)
      .def_readonly("particles", &loc::Estimate::particles)
      .def_readonly("heading_known", &loc::Estimate::heading_known)
      .def_readonly("spread_known", &loc::Estimate::spread_known);
  py::class_<loc::Weighed>(module, "MclWeighed")
      .def_readonly("informative", &loc::Weighed::informative)
      .def_readonly("log_evidence", &loc::Weighed::log_evidence)
      .def_readonly("fit", &loc::Weighed::fit)
      .def_readonly("injected_share", &loc::Weighed::injected_share)
      .def_readonly("exponent", &loc::Weighed::exponent);
  py::class_<loc::Recovery>(module, "MclRecovery")
      .def(py::init<double, double>(), "alpha_slow"_a, "alpha_fast"_a)
      .def("add", &loc::Recovery::add, "fit"_a)
      .def("reset", &loc::Recovery::reset)
      .def_property_readonly("injected_share", &loc::Recovery::injected_share);
  py::class_<loc::FilterParams>(module, "MclRule")
      .def(py::init(&rule_of), py::kw_only(), "min_particles"_a, "max_particles"_a, "kld_error"_a,
           "kld_quantile"_a, "bucket_x_m"_a, "bucket_y_m"_a, "bucket_yaw_rad"_a,
           "resampling"_a = "low_variance", "alpha_slow"_a = 0.0, "alpha_fast"_a = 0.0,
           "resample_interval"_a = 1, "selective"_a = false, "max_step_m"_a = 1e6,
           "least_effective_share"_a = 0.0, "draw_exponent"_a = 1.0);
}

}  // namespace

void bind_localization_filter(py::module_& module) {
  using Filter = loc::ParticleFilter;
  const auto unlocked = py::call_guard<py::gil_scoped_release>();
  bind_results(module);
  py::class_<Filter>(module, "MclFilter")
      .def(py::init<const loc::FilterParams&, std::uint64_t, int>(), "rule"_a, "seed"_a,
           "threads"_a = 1)
      .def("set_rule", &Filter::set_rule, "rule"_a)
      .def("set_threads", &Filter::set_threads, "threads"_a)
      .def(
          "start_about",
          [](Filter& filter, const py::object& mean, const py::object& covariance) {
            filter.start_about(pose_of(mean, "mean"), matrix_of(covariance, "covariance"));
          },
          "mean"_a, "covariance"_a)
      .def("start_anywhere", &Filter::start_anywhere, "free"_a, unlocked)
      .def(
          "start_by_scan",
          [](Filter& filter, const loc::FreeSpace& free, const loc::LikelihoodField& field,
             const loc::Endpoints& ends, std::size_t poses, double kappa) {
            loc::Search search;
            search.poses = poses;
            search.kappa = kappa;
            const py::gil_scoped_release release;
            filter.start_by_scan(free, field, ends, search);
          },
          "free"_a, "field"_a, "ends"_a, "poses"_a, "kappa"_a = 1.0)
      .def("start_with", &start_with, "poses"_a, "weights"_a = py::none())
      .def("state", &state_of)
      .def("restore", &restore, "poses"_a, "log_weights"_a, "numbers"_a, "averages"_a)
      .def("predict", &predict, "before"_a, "now"_a, "model"_a, "alphas"_a, "floor_xy_m"_a = 0.0,
           "floor_yaw_rad"_a = 0.0)
      .def(
          "weigh_field",
          [](Filter& filter, const loc::LikelihoodField& field, const loc::Endpoints& ends,
             const std::string& aggregation, double kappa) {
            return weighed(filter, field, ends, aggregation_of(aggregation), kappa);
          },
          "field"_a, "ends"_a, "aggregation"_a = "cube_sum", "kappa"_a = 1.0)
      .def(
          "weigh_beams",
          [](Filter& filter, const loc::RangeMap& map, const loc::Beams& beams,
             const loc::BeamModel& model, const std::string& aggregation, double kappa) {
            return weighed(filter, map, beams, model, aggregation_of(aggregation), kappa);
          },
          "map"_a, "beams"_a, "model"_a, "aggregation"_a = "cube_sum", "kappa"_a = 1.0)
      .def(
          "weigh",
          [](Filter& filter, const py::object& log_likelihood, std::size_t beams,
             const std::string& kind, double kappa) {
            return filter.weigh(vector_of<double>(log_likelihood, "log_likelihood"), beams,
                                kind_of(kind), kappa);
          },
          "log_likelihood"_a, "beams"_a, "kind"_a = "product", "kappa"_a = 1.0)
      .def("resample_if_due", &Filter::resample_if_due, "free"_a = py::none(), unlocked)
      .def("resample", &Filter::resample, "free"_a = py::none(), unlocked)
      .def("effective_size", &Filter::effective_size)
      .def("estimate", &Filter::estimate, unlocked)
      .def("modes", &modes_of, "bucket_xy_m"_a = 0.2, "bucket_yaw_rad"_a = 0.524)
      .def("__len__", [](const Filter& filter) { return filter.particles().size(); })
      .def_property_readonly("poses",
                             [](const Filter& filter) { return poses_of(filter.particles()); })
      .def_property_readonly("weights",
                             [](const Filter& filter) { return array_of(filter.weights()); })
      .def_property_readonly(
          "log_weights",
          [](const Filter& filter) { return array_of(filter.particles().log_weight); })
      .def_property_readonly("counts", &counts_of);
  module.def("mcl_estimate", &estimate_of_poses, "poses"_a, "weights"_a);
  module.def("mcl_square_root", &root_of, "covariance"_a);
}

}  // namespace mapperd::python
