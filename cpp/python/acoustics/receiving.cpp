// Cells, beams and receiver as Python sees them: shapes are checked here.
#include "receiving.hpp"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <cmath>
#include <complex>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <vector>

#include "mapperd/acoustics/beams.hpp"
#include "mapperd/acoustics/cells.hpp"
#include "mapperd/acoustics/complex_gaussian.hpp"
#include "mapperd/acoustics/receiver.hpp"

namespace acoustics = mapperd::acoustics;

namespace py = pybind11;

namespace {

using Complex = std::complex<float>;
using Floats = py::array_t<float, py::array::c_style | py::array::forcecast>;
using Doubles = py::array_t<double, py::array::c_style | py::array::forcecast>;
using Columns = py::array_t<std::int32_t, py::array::c_style | py::array::forcecast>;
using Firsts = py::array_t<std::int64_t, py::array::c_style | py::array::forcecast>;

std::size_t size_of(const py::array& array, int axis) {
  return static_cast<std::size_t>(array.shape(axis));
}

void demand(bool holds, const char* what) {
  if (!holds) throw std::invalid_argument(what);
}

py::array_t<Complex> complex_gaussian(std::uint64_t key, std::size_t count) {
  py::array_t<Complex> numbers(static_cast<py::ssize_t>(count));
  auto* out = reinterpret_cast<float*>(numbers.mutable_data());
  const py::gil_scoped_release unlocked;
  acoustics::complex_gaussians(key, 0, count, out);
  return numbers;
}

// A field that is written in place must be the caller's own memory.
float* writable(py::array_t<Complex>& field) {
  demand(field.ndim() == 2 && (field.flags() & py::array::c_style) != 0,
         "a field is a C-contiguous array (rows, columns)");
  return reinterpret_cast<float*>(field.mutable_data());
}

void add_gaussian(py::array_t<Complex>& field, const Floats& row_rms, const Floats& column_rms,
                  std::uint64_t key, unsigned threads, const std::optional<Floats>& extra_power) {
  float* cells = writable(field);
  const std::size_t rows = size_of(field, 0);
  const std::size_t columns = size_of(field, 1);
  demand(row_rms.ndim() == 1 && size_of(row_rms, 0) == rows, "one row_rms a row");
  demand(column_rms.ndim() == 1 && size_of(column_rms, 0) == columns, "one column_rms a column");
  acoustics::CellLevels levels{row_rms.data(), column_rms.data()};
  if (extra_power) {
    demand(extra_power->ndim() == 2 && size_of(*extra_power, 0) == rows &&
               (size_of(*extra_power, 1) == 1 || size_of(*extra_power, 1) == columns),
           "extra_power is (rows, columns) or (rows, 1)");
    levels.extra_power = extra_power->data();
    levels.extra_columns = size_of(*extra_power, 1);
  }
  const py::gil_scoped_release unlocked;
  acoustics::add_gaussian(cells, rows, columns, levels, key, threads);
}

void add_gaussian_power(py::array_t<Complex>& field, const Floats& power, std::uint64_t key,
                        unsigned threads, double first, double step) {
  float* cells = writable(field);
  const std::size_t rows = size_of(field, 0);
  const std::size_t columns = size_of(field, 1);
  demand(power.ndim() == 2 && size_of(power, 0) == rows && size_of(power, 1) > 0,
         "power is (rows, at least one)");
  demand(step > 0.0 && std::isfinite(first) && std::isfinite(step), "a step is positive");
  demand(step != 1.0 || first != 0.0 || size_of(power, 1) == columns,
         "power at each column has the field's shape");
  const acoustics::CoarseColumns coarse{size_of(power, 1), first, step};
  const float* of_cell = power.data();
  const py::gil_scoped_release unlocked;
  acoustics::add_gaussian_power(cells, rows, columns, of_cell, coarse, key, threads);
}

// The array as floats, and how many of them a cell has.
struct CellArray {
  explicit CellArray(const py::array& array)
      : is_complex(array.dtype().kind() == 'c'),
        held(is_complex ? py::array(py::array_t<Complex, py::array::c_style>::ensure(array))
                        : py::array(Floats::ensure(array))) {
    demand(static_cast<bool>(held) && held.ndim() == 2,
           "cells and beams are complex64 or float32 and two-dimensional");
    grid = {static_cast<const float*>(held.data()), size_of(held, 0), size_of(held, 1),
            is_complex ? std::size_t{2} : std::size_t{1}};
  }

  py::array like(std::size_t rows, std::size_t columns) const {
    const std::vector<std::size_t> shape{rows, columns};
    return is_complex ? py::array(py::array_t<Complex>(shape))
                      : py::array(py::array_t<float>(shape));
  }

  bool is_complex;
  py::array held;
  acoustics::CellGrid grid;
};

py::array_t<float> block_powers(const py::array& cells, std::size_t width, unsigned threads) {
  const CellArray from(cells);
  demand(width > 0, "a width is positive");
  const std::size_t rows = from.grid.rows;
  const std::size_t columns = from.grid.columns;
  py::array_t<float> power(std::vector<std::size_t>{rows, (columns + width - 1) / width});
  float* out = power.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::block_powers(from.grid.cells, from.grid.parts, rows, columns, width, out, threads);
  return power;
}

template <typename Real>
py::array sum_of(const py::array_t<Real, py::array::c_style>& power, double energy, double kept) {
  const std::size_t rows = size_of(power, 0);
  const std::size_t columns = size_of(power, 1);
  py::array_t<Real> sum(std::vector<std::size_t>{rows, columns});
  Real* out = sum.mutable_data();
  const Real* from = power.data();
  const py::gil_scoped_release unlocked;
  acoustics::decaying_sum(from, rows, columns, energy, kept, out);
  return sum;
}

py::array decaying_sum(const py::array& power, double energy, double kept) {
  demand(power.ndim() == 2, "power is two-dimensional");
  if (power.dtype().is(py::dtype::of<float>())) return sum_of<float>(power, energy, kept);
  demand(power.dtype().is(py::dtype::of<double>()), "power is float32 or float64");
  return sum_of<double>(power, energy, kept);
}

template <typename Real>
py::array product_of(const py::array_t<Real, py::array::c_style>& power,
                     const py::array_t<Real, py::array::c_style | py::array::forcecast>& weights,
                     unsigned threads) {
  const std::size_t rows = size_of(power, 0);
  const std::size_t columns = size_of(power, 1);
  const std::size_t out_columns = size_of(weights, 1);
  py::array_t<Real> product(std::vector<std::size_t>{rows, out_columns});
  Real* out = product.mutable_data();
  const Real* from = power.data();
  const Real* by = weights.data();
  const py::gil_scoped_release unlocked;
  acoustics::spread_columns(from, rows, columns, by, out_columns, out, threads);
  return product;
}

py::array spread_columns(const py::array& power, const py::array& weights, unsigned threads) {
  demand(power.ndim() == 2 && weights.ndim() == 2 && power.shape(1) == weights.shape(0),
         "weights have a row for each column of the power");
  if (power.dtype().is(py::dtype::of<float>())) return product_of<float>(power, weights, threads);
  demand(power.dtype().is(py::dtype::of<double>()), "power is float32 or float64");
  return product_of<double>(power, weights, threads);
}

void add_cloud(py::array_t<float>& power, const Doubles& enter_row, const Doubles& leave_row,
               const Columns& column, const Doubles& weight, const Doubles& row_fade,
               const Doubles& column_fade, const Doubles& level) {
  demand(power.ndim() == 2 && (power.flags() & py::array::c_style) != 0,
         "power is a C-contiguous array (rows, columns)");
  const std::size_t rows = size_of(power, 0);
  const std::size_t columns = size_of(power, 1);
  const auto count = static_cast<std::size_t>(enter_row.size());
  for (const py::ssize_t size : {leave_row.size(), column.size(), weight.size()}) {
    demand(static_cast<std::size_t>(size) == count, "one number a ray");
  }
  demand(static_cast<std::size_t>(row_fade.size()) == rows &&
             static_cast<std::size_t>(level.size()) == rows,
         "one row_fade and level a row");
  demand(static_cast<std::size_t>(column_fade.size()) == columns, "one column_fade a column");
  for (std::size_t i = 0; i < count; ++i) {
    const std::int32_t at = column.data()[i];
    demand(at >= 0 && static_cast<std::size_t>(at) < columns, "columns lie within the power");
    demand(enter_row.data()[i] >= 0.0 && leave_row.data()[i] >= enter_row.data()[i],
           "a ray leaves no earlier than it enters, at 0 or later");
  }
  const acoustics::CloudRays rays{count, enter_row.data(), leave_row.data(), column.data(),
                                  weight.data()};
  const acoustics::CloudFade fade{row_fade.data(), column_fade.data(), level.data()};
  float* out = power.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::add_cloud(out, rows, columns, rays, fade);
}

py::tuple box_crossing(const Doubles& box_m, const Doubles& origin_m, const Floats& direction,
                       const Doubles& reach_m) {
  demand(box_m.ndim() == 2 && size_of(box_m, 0) == 2 && size_of(box_m, 1) == 3, "box_m is (2, 3)");
  demand(origin_m.size() == 3, "origin_m is (3,)");
  const py::ssize_t count = reach_m.size();
  demand(direction.ndim() == 2 && size_of(direction, 1) == 3 && reach_m.ndim() == 1 &&
             direction.shape(0) == count,
         "direction is (N, 3), reach_m (N,)");
  double corner[6];
  for (std::size_t k = 0; k < 6; ++k) corner[k] = box_m.data()[k] - origin_m.data()[k % 3];
  Doubles enter(count), leave(count);
  double* from = enter.mutable_data();
  double* to = leave.mutable_data();
  {
    const py::gil_scoped_release unlocked;
    acoustics::box_crossing(corner, corner + 3, static_cast<std::size_t>(count), direction.data(),
                            reach_m.data(), from, to);
  }
  return py::make_tuple(enter, leave);
}

void demand_odd(const Floats& taps, const char* what) {
  demand(taps.ndim() == 1 && size_of(taps, 0) % 2 == 1, what);
}

py::array form_beams(const py::array& cells, const Floats& taps, std::size_t first,
                     std::size_t beams, const Floats& range_taps, unsigned threads) {
  const CellArray from(cells);
  demand_odd(taps, "taps are an odd number");
  demand_odd(range_taps, "range_taps are an odd number");
  py::array formed = from.like(from.grid.rows, beams);
  auto* out = static_cast<float*>(formed.mutable_data());
  const acoustics::Response response{taps.data(), size_of(taps, 0), range_taps.data(),
                                     size_of(range_taps, 0)};
  const py::gil_scoped_release unlocked;
  acoustics::form_beams(from.grid, response, first, beams, out, threads);
  return formed;
}

py::array form_beams_at(const py::array& cells, const Floats& taps, const Firsts& firsts,
                        const Floats& range_taps, unsigned threads) {
  const CellArray from(cells);
  demand(taps.ndim() == 2 && firsts.ndim() == 1 && size_of(firsts, 0) == size_of(taps, 0),
         "taps are (beams, count) and firsts (beams,)");
  demand_odd(range_taps, "range_taps are an odd number");
  const std::size_t beams = size_of(taps, 0);
  py::array formed = from.like(from.grid.rows, beams);
  auto* out = static_cast<float*>(formed.mutable_data());
  const acoustics::Response response{taps.data(), size_of(taps, 1), range_taps.data(),
                                     size_of(range_taps, 0)};
  const std::int64_t* at = firsts.data();
  const py::gil_scoped_release unlocked;
  acoustics::form_beams_at(from.grid, response, at, beams, out, threads);
  return formed;
}

py::array_t<float> amplitudes(const py::array& beams, const Floats& gain, unsigned threads) {
  const CellArray from(beams);
  demand(gain.ndim() == 1 && size_of(gain, 0) == from.grid.rows, "one gain a row");
  py::array_t<float> shown(std::vector<std::size_t>{from.grid.rows, from.grid.columns});
  float* out = shown.mutable_data();
  const acoustics::Receiver receiver{gain.data(), 1.0F, false};
  const py::gil_scoped_release unlocked;
  acoustics::amplitudes(from.grid.cells, from.grid.parts, from.grid.rows, from.grid.columns,
                        receiver, out, threads);
  return shown;
}

template <typename Pixel>
py::array quantised(const Floats& amplitude, const acoustics::Receiver& receiver,
                    unsigned threads) {
  py::array_t<Pixel> image(
      std::vector<py::ssize_t>(amplitude.shape(), amplitude.shape() + amplitude.ndim()));
  Pixel* out = image.mutable_data();
  const py::gil_scoped_release unlocked;
  const auto count = static_cast<std::size_t>(amplitude.size());
  if constexpr (std::is_same_v<Pixel, float>) {
    acoustics::apply_gamma(amplitude.data(), count, receiver, out, threads);
  } else {
    acoustics::quantised(amplitude.data(), count, receiver, out, threads);
  }
  return image;
}

py::array pixels(const Floats& amplitude, float gamma, int bits, bool clip, unsigned threads) {
  demand(gamma > 0.0F && gamma <= 2.0F, "gamma lies in (0, 2]");
  const acoustics::Receiver receiver{nullptr, gamma, clip};
  switch (bits) {
    case 0:
      return quantised<float>(amplitude, receiver, threads);
    case 8:
      return quantised<std::uint8_t>(amplitude, receiver, threads);
    case 16:
      return quantised<std::uint16_t>(amplitude, receiver, threads);
    case 32:
      return quantised<std::uint32_t>(amplitude, receiver, threads);
    default:
      throw std::invalid_argument("bits are 0 (floats), 8, 16 or 32");
  }
}

}  // namespace

void bind_receiving(py::module_& module) {
  using py::arg;
  module.def("complex_gaussian", &complex_gaussian, arg("key"), arg("count"));
  module.def("add_gaussian", &add_gaussian, arg("field").noconvert(), arg("row_rms"),
             arg("column_rms"), arg("key"), arg("threads") = 2, arg("extra_power") = py::none());
  module.def("add_gaussian_power", &add_gaussian_power, arg("field").noconvert(), arg("power"),
             arg("key"), arg("threads") = 2, arg("first") = 0.0, arg("step") = 1.0);
  module.def("block_powers", &block_powers, arg("cells"), arg("width"), arg("threads") = 2);
  module.def("decaying_sum", &decaying_sum, arg("power"), arg("energy"), arg("kept"));
  module.def("spread_columns", &spread_columns, arg("power"), arg("weights"), arg("threads") = 2);
  module.def("box_crossing", &box_crossing, arg("box_m"), arg("origin_m"), arg("direction"),
             arg("reach_m"));
  module.def("add_cloud", &add_cloud, arg("power").noconvert(), arg("enter_row"), arg("leave_row"),
             arg("column"), arg("weight"), arg("row_fade"), arg("column_fade"), arg("level"));
  module.def("form_beams", &form_beams, arg("cells"), arg("taps"), arg("first"), arg("beams"),
             arg("range_taps"), arg("threads") = 2);
  module.def("form_beams_at", &form_beams_at, arg("cells"), arg("taps"), arg("firsts"),
             arg("range_taps"), arg("threads") = 2);
  module.def("amplitudes", &amplitudes, arg("beams"), arg("gain"), arg("threads") = 2);
  module.def("pixels", &pixels, arg("amplitude"), arg("gamma"), arg("bits"), arg("clip"),
             arg("threads") = 2);
}
