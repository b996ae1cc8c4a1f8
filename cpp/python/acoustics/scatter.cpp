#include "scatter.hpp"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <complex>
#include <optional>
#include <vector>

#include "checked_array.hpp"
#include "mapperd/acoustics/footprint.hpp"
#include "mapperd/acoustics/preview.hpp"
#include "mapperd/acoustics/scatter.hpp"

namespace acoustics = mapperd::acoustics;

namespace py = pybind11;

namespace {

// Keeps what its view points into.
struct FaceTable {
  std::vector<acoustics::Face> faces;
  Array<double> curved_normal, materials;

  [[nodiscard]] acoustics::Faces view() const {
    return {faces.data(), curved_normal.data(),
            reinterpret_cast<const acoustics::Material*>(materials.data())};
  }
};

FaceTable face_table(Array<double> planes, Array<std::uint32_t> objects,
                     Array<std::int32_t> materials, Array<std::int32_t> smooth,
                     Array<double> curved_normal, Array<double> table) {
  require(planes.ndim() == 2 && planes.shape(1) == 4, "planes must be (F, 4)");
  const py::ssize_t count = planes.shape(0);
  require(objects.size() == count && materials.size() == count && smooth.size() == count,
          "objects, materials and smooth must be (F,)");
  require(curved_normal.ndim() == 2 && curved_normal.shape(1) == 12,
          "curved_normal must be (S, 12)");
  require(table.ndim() == 2 && table.shape(1) == 4, "table must be (M, 4)");
  FaceTable faces{{}, curved_normal, table};
  faces.faces.reserve(static_cast<std::size_t>(count));
  for (py::ssize_t i = 0; i < count; ++i) {
    acoustics::Face face{{}, 0.0, objects.data()[i], materials.data()[i], smooth.data()[i]};
    require(face.material >= 0 && face.material < table.shape(0), "materials out of the table");
    require(face.smooth < curved_normal.shape(0), "smooth beyond curved_normal");
    std::copy_n(planes.data() + 4 * i, 4, face.plane);
    if (face.smooth >= 0) {
      face.turn_per_m = acoustics::turn_per_m(curved_normal.data() + 12 * face.smooth);
    }
    faces.faces.push_back(face);
  }
  return faces;
}

struct ScatterSetting {
  Array<float> loss, vertical, taps;
  acoustics::EchoGrid grid{};
  acoustics::ScatterModel model{};
};

ScatterSetting setting(Array<float> loss, Array<float> vertical, Array<float> taps,
                       py::ssize_t columns, double row_m, double first_sine, double sine_pitch,
                       double range_scale, bool lambert, bool specular, bool spreading,
                       double turns_per_m, double nodes_per_cell, std::uint64_t key) {
  require(loss.ndim() == 1 && vertical.size() >= 2, "loss must be (rows,), vertical (2 or more,)");
  require(taps.ndim() == 2 && taps.shape(1) % 2 == 0 && taps.size() > 0, "taps must be (F, even)");
  return {loss,
          vertical,
          taps,
          {loss.shape(0), columns, row_m, first_sine, sine_pitch, range_scale},
          {lambert, specular, spreading, turns_per_m, nodes_per_cell, key}};
}

struct RayArrays {
  Array<std::int32_t> face, seen, transmit, receive;
  Array<float> cell, span_m, gain;
  Array<double> legs;
  bool both_ways = false;
  std::optional<Array<float>> lean;
};

void check(const FaceTable& faces, const RayArrays& rays) {
  static_assert(sizeof(acoustics::Leg) == 16 * sizeof(double));
  const py::ssize_t count = rays.face.size();
  require(rays.seen.size() == count && rays.transmit.size() == count &&
              rays.receive.size() == count && rays.gain.size() == count &&
              rays.cell.size() == 4 * count && rays.span_m.size() == 2 * count,
          "face, seen, transmit, receive, gain must be (H,), cell (H, 4), span_m (H, 2)");
  require(!rays.lean || rays.lean->size() == 2 * count, "lean must be (H, 2)");
  require(rays.legs.ndim() == 2 && rays.legs.shape(1) == 16, "legs must be (L, 16)");
  const auto legs = static_cast<std::int32_t>(rays.legs.shape(0));
  const auto all = static_cast<std::int32_t>(faces.faces.size());
  for (py::ssize_t i = 0; i < count; ++i) {
    require(rays.face.data()[i] < all, "face out of the table");
    require(rays.seen.data()[i] >= 0 && rays.seen.data()[i] < legs &&
                rays.transmit.data()[i] >= 0 && rays.transmit.data()[i] < legs &&
                rays.receive.data()[i] >= 0 && rays.receive.data()[i] < legs,
            "leg out of the table");
  }
  for (std::int32_t i = 0; rays.both_ways && i < legs; ++i) {
    const double* drift = rays.legs.data() + 16 * i + 12;
    require(drift[0] == 0.0 && drift[1] == 0.0 && drift[2] == 0.0,
            "legs of both ways must have no drift");
  }
}

acoustics::ScatterInput echoes_of(const FaceTable& faces, const RayArrays& rays,
                                  const ScatterSetting& s) {
  check(faces, rays);
  return {
      faces.view(),
      {static_cast<std::size_t>(rays.face.size()), rays.face.data(), rays.seen.data(),
       rays.transmit.data(), rays.receive.data(), rays.cell.data(), rays.span_m.data(),
       rays.gain.data(), reinterpret_cast<const acoustics::Leg*>(rays.legs.data()), rays.both_ways,
       rays.lean ? rays.lean->data() : nullptr},
      s.grid,
      {s.loss.data(), s.vertical.data(), static_cast<std::size_t>(s.vertical.size()), s.taps.data(),
       static_cast<std::size_t>(s.taps.shape(0)), static_cast<std::size_t>(s.taps.shape(1))},
      s.model};
}

template <typename T>
T* cells_of(Array<T>& grid, const ScatterSetting& s) {
  require(grid.ndim() == 2 && grid.shape(0) == s.grid.rows && grid.shape(1) == s.grid.columns,
          "the grid must be (rows, columns)");
  return grid.mutable_data();
}

void scatter_field(Array<std::complex<float>> field, const FaceTable& faces, const RayArrays& rays,
                   const ScatterSetting& s, int threads) {
  const acoustics::ScatterInput echoes = echoes_of(faces, rays, s);
  auto* cells = cells_of(field, s);
  const py::gil_scoped_release unlocked;
  acoustics::scatter_field(echoes, cells, threads);
}

void scatter_power(Array<float> power, const FaceTable& faces, const RayArrays& rays,
                   const ScatterSetting& s, int threads) {
  const acoustics::ScatterInput echoes = echoes_of(faces, rays, s);
  auto* cells = cells_of(power, s);
  const py::gil_scoped_release unlocked;
  acoustics::scatter_power(echoes, cells, threads);
}

RayArrays rays_of(Array<std::int32_t> face, Array<std::int32_t> seen, Array<std::int32_t> transmit,
                  Array<std::int32_t> receive, Array<float> cell, Array<float> span_m,
                  Array<float> gain, Array<double> legs, bool both_ways,
                  std::optional<Array<float>> lean) {
  return {face, seen, transmit, receive, cell, span_m, gain, legs, both_ways, lean};
}

py::tuple coarse_patches(const FaceTable& faces, const Array<std::int32_t>& face,
                         const Array<std::int32_t>& group, const Array<float>& range_m,
                         const Array<double>& direction, const Array<double>& solid_angle_sr,
                         double s_step, double w_step, const Array<double>& map_T_sonar,
                         const Array<double>& map_T_group, double reach_m) {
  const py::ssize_t count = face.size();
  require(group.size() == count && range_m.size() == count && solid_angle_sr.size() == count,
          "face, group, range_m, solid_angle_sr must be (N,)");
  require(direction.ndim() == 2 && direction.size() == 3 * count, "direction must be (N, 3)");
  require(map_T_sonar.size() == 12, "map_T_sonar must be (12,)");
  require(map_T_group.ndim() == 2 && map_T_group.shape(1) == 12, "map_T_group must be (G, 12)");
  std::vector<mapperd::Transform> poses;
  for (py::ssize_t i = 0; i < map_T_group.shape(0); ++i) {
    poses.push_back(transform_of(map_T_group.data() + 12 * i));
  }
  const auto all = static_cast<std::int32_t>(faces.faces.size());
  py::ssize_t most = 0;
  for (py::ssize_t i = 0; i < count; ++i) {
    if (face.data()[i] < 0) continue;
    ++most;
    require(face.data()[i] < all, "face out of the table");
    require(group.data()[i] >= 0 && static_cast<std::size_t>(group.data()[i]) < poses.size(),
            "group out of map_T_group");
  }
  Array<std::int64_t> ray(most);
  const std::vector<py::ssize_t> vectors{most, 3};
  Array<double> point_m(vectors), normal(vectors), turn(vectors);
  Array<double> cos_incidence(most), area_m2(most), extent_m(most);
  const acoustics::CoarseRays rays{static_cast<std::size_t>(count),
                                   face.data(),
                                   group.data(),
                                   range_m.data(),
                                   direction.data(),
                                   solid_angle_sr.data(),
                                   s_step,
                                   w_step,
                                   transform_of(map_T_sonar.data())};
  const acoustics::CoarsePatches to{ray.mutable_data(),     point_m.mutable_data(),
                                    normal.mutable_data(),  cos_incidence.mutable_data(),
                                    area_m2.mutable_data(), extent_m.mutable_data(),
                                    turn.mutable_data()};
  py::ssize_t found = 0;
  {
    const py::gil_scoped_release unlocked;
    found = static_cast<py::ssize_t>(
        acoustics::coarse_patches(faces.view(), rays, reach_m, poses.data(), to));
  }
  const py::slice some(0, found, 1);
  return py::make_tuple(ray[some], point_m[some], normal[some], cos_incidence[some], area_m2[some],
                        extent_m[some], turn[some]);
}

}  // namespace

void bind_scatter(py::module_& module) {
  using py::arg;
  py::class_<FaceTable>(module, "FaceTable")
      .def(py::init(&face_table), arg("planes"), arg("objects"), arg("materials"), arg("smooth"),
           arg("curved_normal"), arg("table"))
      .def("coarse_patches", &coarse_patches, arg("face"), arg("group"), arg("range_m"),
           arg("direction"), arg("solid_angle_sr"), arg("s_step"), arg("w_step"),
           arg("map_T_sonar"), arg("map_T_group"), arg("reach_m"));
  py::class_<RayArrays>(module, "Rays")
      .def(py::init(&rays_of), arg("face"), arg("seen"), arg("transmit"), arg("receive"),
           arg("cell"), arg("span_m"), arg("gain"), arg("legs"), arg("both_ways") = false,
           arg("lean") = py::none());
  py::class_<ScatterSetting>(module, "ScatterSetting")
      .def(py::init(&setting), arg("loss"), arg("vertical"), arg("taps"), arg("columns"),
           arg("row_m"), arg("first_sine"), arg("sine_pitch"), arg("range_scale"), arg("lambert"),
           arg("specular"), arg("spreading"), arg("turns_per_m"), arg("nodes_per_cell"),
           arg("key"));
  module.def("scatter_field", &scatter_field, arg("field").noconvert(), arg("faces"), arg("rays"),
             arg("setting"), arg("threads"));
  module.def("scatter_power", &scatter_power, arg("power").noconvert(), arg("faces"), arg("rays"),
             arg("setting"), arg("threads"));
}
