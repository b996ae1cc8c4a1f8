// The coarse picture of a ping and the difference between two, as Python sees them.
#include "previewing.hpp"

#include <pybind11/numpy.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "checked_array.hpp"
#include "mapperd/acoustics/preview.hpp"

namespace acoustics = mapperd::acoustics;

namespace py = pybind11;

namespace {

Array<double> spread_over_rows(const Array<std::int64_t>& column, const Array<double>& range_m,
                               const Array<double>& extent_m, const Array<double>& power,
                               double row_m, std::size_t rows, std::size_t columns) {
  const py::ssize_t count = column.size();
  require(range_m.size() == count && extent_m.size() == count && power.size() == count,
          "column, range_m, extent_m, power must be (N,)");
  require(row_m > 0.0 && std::isfinite(row_m), "row_m must be positive");
  const std::int64_t* at = column.data();
  const auto end = static_cast<std::int64_t>(columns);
  require(std::all_of(at, at + count, [end](std::int64_t c) { return c >= 0 && c < end; }),
          "column out of the picture");
  Array<double> picture(std::vector<std::size_t>{rows, columns});
  double* const out = picture.mutable_data();
  const acoustics::RangePatches patches{static_cast<std::size_t>(count), at, range_m.data(),
                                        extent_m.data(), power.data()};
  const py::gil_scoped_release unlocked;
  acoustics::spread_over_rows(patches, row_m, rows, columns, out);
  return picture;
}

Array<float> limited(const py::array_t<double, py::array::c_style | py::array::forcecast>& from,
                     double limit, double factor) {
  Array<float> to(std::vector<py::ssize_t>(from.shape(), from.shape() + from.ndim()));
  float* const out = to.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::limited(from.data(), static_cast<std::size_t>(from.size()), limit, factor, out);
  return to;
}

acoustics::PicturePair pair_of(const Array<float>& first, const Array<float>& second, float gamma,
                               double row_cells, double column_cells) {
  require(first.ndim() == 2 && second.ndim() == 2 && first.shape(0) == second.shape(0) &&
              first.shape(1) == second.shape(1),
          "the pictures must be (rows, columns) both");
  require(gamma > 0.0F && gamma <= 2.0F, "gamma must lie in (0, 2]");
  require(row_cells >= 0.0 && column_cells >= 0.0, "displacements must be 0 or more");
  return {first.data(),
          second.data(),
          static_cast<std::size_t>(first.shape(0)),
          static_cast<std::size_t>(first.shape(1)),
          gamma,
          row_cells,
          column_cells};
}

double pixel_change_db(const Array<float>& first, const Array<float>& second, float gamma,
                       float largest_pixel, std::size_t exceeding, double row_cells,
                       double column_cells) {
  const acoustics::PicturePair pictures = pair_of(first, second, gamma, row_cells, column_cells);
  require(largest_pixel >= 1.0F, "largest_pixel must be 1 or more");
  const py::gil_scoped_release unlocked;
  return acoustics::pixel_change_db(pictures, largest_pixel, exceeding);
}

double dark_change_db(const Array<float>& first, const Array<float>& second, float gamma,
                      const Array<float>& mean_pixel, float limit, double row_cells,
                      double column_cells) {
  const acoustics::PicturePair pictures = pair_of(first, second, gamma, row_cells, column_cells);
  require(mean_pixel.ndim() == 1 && mean_pixel.size() >= 2, "mean_pixel must be (2 or more,)");
  require(limit >= 0.0F, "limit must be 0 or more");
  const acoustics::DarkPixels dark{mean_pixel.data(),
                                   static_cast<std::size_t>(mean_pixel.size() - 1), limit};
  const py::gil_scoped_release unlocked;
  return acoustics::dark_change_db(pictures, dark);
}

}  // namespace

void bind_previewing(py::module_& module) {
  using py::arg;
  module.def("spread_over_rows", &spread_over_rows, arg("column"), arg("range_m"), arg("extent_m"),
             arg("power"), arg("row_m"), arg("rows"), arg("columns"));
  module.def("limited", &limited, arg("numbers"), arg("limit"), arg("factor") = 1.0);
  module.def("pixel_change_db", &pixel_change_db, arg("first"), arg("second"), arg("gamma"),
             arg("largest_pixel"), arg("exceeding"), arg("row_cells") = 0.0,
             arg("column_cells") = 0.0);
  module.def("dark_change_db", &dark_change_db, arg("first"), arg("second"), arg("gamma"),
             arg("mean_pixel"), arg("limit"), arg("row_cells") = 0.0, arg("column_cells") = 0.0);
}
