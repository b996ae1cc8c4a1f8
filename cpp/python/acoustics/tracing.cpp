#include "tracing.hpp"

#include <pybind11/numpy.h>

#include <algorithm>
#include <cstring>
#include <string>
#include <vector>

#include "checked_array.hpp"
#include "mapperd/acoustics/neighbours.hpp"

namespace acoustics = mapperd::acoustics;

namespace py = pybind11;

namespace {

void check_faces(const Array<std::int32_t>& face, py::ssize_t all) {
  const std::int32_t* at = face.data();
  require(std::all_of(at, at + face.size(), [all](std::int32_t f) { return f < all; }),
          "face out of the table");
}

py::array edges(const Array<float>& direction, const Array<float>& range_m,
                const Array<std::int32_t>& face, const Array<std::int32_t>& group,
                const Array<std::int32_t>& column, const Array<float>& normals,
                const Array<std::int32_t>& smooth, float max_slope, float min_step_m,
                float turned) {
  const py::ssize_t count = face.size();
  require(direction.size() == 3 * count && range_m.size() == count && group.size() == count &&
              column.size() == count,
          "range_m, face, group, column must be (N,), direction (N, 3)");
  require(normals.size() == 3 * smooth.size(), "smooth must be (F,), normals (F, 3)");
  check_faces(face, smooth.size());
  std::vector<std::int64_t> found;
  {
    const py::gil_scoped_release unlocked;
    found = acoustics::edges({static_cast<std::size_t>(count), direction.data(), range_m.data(),
                              face.data(), group.data(), column.data()},
                             normals.data(), smooth.data(), {max_slope, min_step_m, turned});
  }
  return Array<std::int64_t>(static_cast<py::ssize_t>(found.size()), found.data());
}

py::array spans(const Array<float>& range_m, const Array<std::int32_t>& face,
                const Array<std::int32_t>& column, const Array<float>& up,
                const Array<std::int32_t>& surface, const Array<float>& size_m) {
  const py::ssize_t count = face.size();
  require(range_m.size() == count && column.size() == count && up.size() == count,
          "range_m, face, column, up must be (N,)");
  require(surface.size() == size_m.size(), "surface, size_m must be (F,)");
  check_faces(face, surface.size());
  Array<float> out({count, py::ssize_t{2}});
  float* to = out.mutable_data();
  {
    const py::gil_scoped_release unlocked;
    acoustics::spans({static_cast<std::size_t>(count), nullptr, range_m.data(), face.data(),
                      nullptr, column.data()},
                     up.data(), surface.data(), size_m.data(), to);
  }
  return out;
}

// Copies rows of any kind.
py::array inserted(const py::array& rows, const Array<std::int64_t>& after, const py::array& more) {
  constexpr int kPlain = py::array::c_style;
  require((rows.flags() & kPlain) != 0 && (more.flags() & kPlain) != 0 && rows.ndim() >= 1 &&
              rows.ndim() == more.ndim() && rows.dtype().is(more.dtype()) &&
              std::equal(rows.shape() + 1, rows.shape() + rows.ndim(), more.shape() + 1),
          "rows and more must be C-contiguous and of one kind");
  const py::ssize_t count = rows.shape(0);
  const py::ssize_t places = after.size();
  require(places > 0 && more.shape(0) % places == 0, "more must be as many for each place");
  const std::int64_t* at = after.data();
  require(std::is_sorted(at, at + places) && at[0] >= 0 && at[places - 1] < count,
          "after must be sorted and within rows");
  std::vector<py::ssize_t> shape(rows.shape(), rows.shape() + rows.ndim());
  shape[0] += more.shape(0);
  py::array out(rows.dtype(), shape);
  const auto row = static_cast<std::size_t>(rows.nbytes() / std::max<py::ssize_t>(count, 1));
  const std::size_t some = row * static_cast<std::size_t>(more.shape(0) / places);
  const char* from = static_cast<const char*>(rows.data());
  const char* added = static_cast<const char*>(more.data());
  auto* to = static_cast<char*>(out.mutable_data());
  const auto copy = [&to](const char* what, std::size_t bytes) {
    std::memcpy(to, what, bytes);
    to += bytes;
  };
  std::size_t done = 0;
  for (py::ssize_t i = 0; i < places; ++i) {
    const std::size_t end = row * static_cast<std::size_t>(at[i] + 1);
    copy(from + done, end - done);
    copy(added + some * static_cast<std::size_t>(i), some);
    done = end;
  }
  copy(from + done, row * static_cast<std::size_t>(count) - done);
  return out;
}

}  // namespace

void bind_tracing(py::module_& module) {
  using py::arg;
  module.def("edges", &edges, arg("direction"), arg("range_m"), arg("face"), arg("group"),
             arg("column"), arg("normals"), arg("smooth"), arg("max_slope"), arg("min_step_m"),
             arg("turned"));
  module.def("spans", &spans, arg("range_m"), arg("face"), arg("column"), arg("up"), arg("surface"),
             arg("size_m"));
  module.def("inserted", &inserted, arg("rows"), arg("after"), arg("more"));
}
