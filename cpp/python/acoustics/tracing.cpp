#include "tracing.hpp"

#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <functional>
#include <memory>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "checked_array.hpp"
#include "mapperd/acoustics/neighbours.hpp"
#include "mapperd/acoustics/ray_bundle.hpp"
#include "mapperd/acoustics/silhouettes.hpp"
#include "mapperd/acoustics/sound_layers.hpp"

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
                std::int32_t standing, const Array<std::int32_t>& column,
                const Array<float>& normals, const Array<std::int32_t>& smooth, float max_slope,
                float min_step_m, float min_cosine) {
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
                              face.data(), group.data(), standing, column.data()},
                             normals.data(), smooth.data(), {max_slope, min_step_m, min_cosine});
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
                      nullptr, 0, column.data()},
                     up.data(), surface.data(), size_m.data(), to);
  }
  return out;
}

acoustics::MeshEdges edge_table(const Array<float>& corners_m, const Array<float>& normals,
                                const Array<std::int32_t>& surface) {
  const py::ssize_t count = surface.size();
  require(corners_m.size() == 9 * count && normals.size() == 3 * count,
          "corners_m must be (F, 3, 3), normals (F, 3), surface (F,)");
  const py::gil_scoped_release unlocked;
  return acoustics::mesh_edges(corners_m.data(), normals.data(), surface.data(),
                               static_cast<std::size_t>(count));
}

// Its own type: a vector would be copied into a list.
struct TriangleTable {
  std::vector<acoustics::TrianglePack> packs;
};

TriangleTable triangle_table(const Array<float>& corners_m) {
  require(corners_m.ndim() == 3 && corners_m.shape(1) == 3 && corners_m.shape(2) == 3,
          "corners_m must be (F, 3, 3)");
  require(std::all_of(corners_m.data(), corners_m.data() + corners_m.size(),
                      [](float at) { return std::fabs(at) < acoustics::kMaxCornerM; }),
          "corners_m must be less than 1e9 m");
  const py::gil_scoped_release unlocked;
  const auto count = static_cast<std::size_t>(corners_m.shape(0));
  return {acoustics::pack_triangles(corners_m.data(), count)};
}

void cast_bundle(const TriangleTable& table, const Array<double>& origin_m,
                 const Array<float>& direction, const std::optional<Array<float>>& near_m,
                 std::int32_t first_face, Array<float>& range_m, Array<std::int32_t>& face,
                 unsigned threads) {
  const py::ssize_t count = range_m.size();
  require(origin_m.size() == 3 && direction.ndim() == 2 && direction.shape(0) == count &&
              direction.shape(1) == 3 && face.size() == count &&
              (!near_m || near_m->size() == count),
          "origin_m must be (3,), direction (N, 3), near_m, range_m and face (N,)");
  acoustics::RayBundle rays{
      static_cast<std::size_t>(count), {}, direction.data(), near_m ? near_m->data() : nullptr};
  std::copy_n(origin_m.data(), 3, rays.origin_m);
  float* ranges = range_m.mutable_data();
  std::int32_t* faces = face.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::cast_bundle(table.packs, rays, first_face, threads, ranges, faces);
}

void meet_sea(const Array<float>& direction, double depth_m,
              const std::optional<Array<float>>& near_m, std::int32_t sea_face,
              std::int32_t sea_group, Array<float>& range_m, Array<std::int32_t>& face,
              Array<std::int32_t>& group) {
  const py::ssize_t count = range_m.size();
  require(range_m.ndim() == 1 && direction.ndim() == 2 && direction.shape(0) == count &&
              direction.shape(1) == 3 && face.size() == count && group.size() == count &&
              (!near_m || near_m->size() == count),
          "direction must be (N, 3), near_m, range_m, face and group (N,)");
  const acoustics::RayBundle rays{
      static_cast<std::size_t>(count), {}, direction.data(), near_m ? near_m->data() : nullptr};
  float* ranges = range_m.mutable_data();
  std::int32_t* faces = face.mutable_data();
  std::int32_t* groups = group.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::meet_sea(rays, {depth_m, sea_face, sea_group}, ranges, faces, groups);
}

// Rows of one array where `source` names them, and of the other, in order, where it is negative.
py::array merged(const py::array& known, const Array<std::int32_t>& source, const py::array& more) {
  const py::array old = py::array::ensure(known, py::array::c_style);
  const py::array fresh = py::array::ensure(more, py::array::c_style);
  require(old.ndim() >= 1 && fresh.ndim() == old.ndim() && old.dtype().equal(fresh.dtype()) &&
              std::equal(old.shape() + 1, old.shape() + old.ndim(), fresh.shape() + 1),
          "known and more must be alike but for their lengths");
  require(old.dtype().kind() == 'f' || old.dtype().kind() == 'i', "rows must hold numbers");
  require(source.ndim() == 1, "source must be (M,)");
  const std::int32_t* from = source.data();
  const auto count = source.size();
  require(std::all_of(from, from + count, [&](std::int32_t i) { return i < old.shape(0); }),
          "source beyond what is known");
  require(std::count_if(from, from + count, [](std::int32_t i) { return i < 0; }) == fresh.shape(0),
          "more must have a row for each negative source");
  std::vector<py::ssize_t> shape(old.shape(), old.shape() + old.ndim());
  shape[0] = count;
  py::array both(old.dtype(), shape);
  const auto row = static_cast<std::size_t>(
      std::accumulate(shape.begin() + 1, shape.end(), old.itemsize(), std::multiplies<>()));
  auto* to = static_cast<char*>(both.mutable_data());
  const auto* first = static_cast<const char*>(old.data());
  const auto* next = static_cast<const char*>(fresh.data());
  const py::gil_scoped_release unlocked;
  for (py::ssize_t i = 0; i < count;) {
    // Rows that follow one another are copied together.
    const bool is_new = from[i] < 0;
    py::ssize_t end = i + 1;
    while (end < count && (is_new ? from[end] < 0 : from[end] == from[end - 1] + 1)) ++end;
    const std::size_t size = row * static_cast<std::size_t>(end - i);
    std::memcpy(to, is_new ? next : first + row * static_cast<std::size_t>(from[i]), size);
    if (is_new) next += size;
    to += size;
    i = end;
  }
  return both;
}

py::array rotated(const Array<float>& direction, const Array<float>& matrix) {
  require(direction.ndim() == 2 && direction.shape(1) == 3, "direction must be (N, 3)");
  require(matrix.ndim() == 2 && matrix.shape(0) == 3 && matrix.shape(1) == 3,
          "matrix must be (3, 3)");
  const py::ssize_t count = direction.shape(0);
  Array<float> turned({count, py::ssize_t{3}});
  std::array<float, 9> m;
  std::copy_n(matrix.data(), 9, m.begin());
  const float* from = direction.data();
  float* to = turned.mutable_data();
  const py::gil_scoped_release unlocked;
  acoustics::multiply_rows(from, static_cast<std::size_t>(count), m, to);
  return turned;
}

py::array rays_near_ball(const Array<double>& start_m, const Array<float>& direction,
                         double reach_m, const Array<double>& middle_m, double radius_m) {
  require(start_m.ndim() == 2 && start_m.shape(1) == 3 && direction.ndim() == 2 &&
              direction.shape(0) == start_m.shape(0) && direction.shape(1) == 3 &&
              middle_m.size() == 3,
          "start_m and direction must be (N, 3), middle_m (3,)");
  std::vector<std::int64_t> near;
  {
    const py::gil_scoped_release unlocked;
    near = acoustics::rays_near_ball(static_cast<std::size_t>(start_m.shape(0)), start_m.data(),
                                     direction.data(), reach_m, middle_m.data(), radius_m);
  }
  return Array<std::int64_t>(static_cast<py::ssize_t>(near.size()), near.data());
}

// An array that owns the values, without a copy; rows of one number are numbers.
template <typename T>
py::array rows_of(std::vector<T>&& values, py::ssize_t wide) {
  auto kept = std::make_unique<std::vector<T>>(std::move(values));
  const auto count = static_cast<py::ssize_t>(kept->size()) / wide;
  const T* data = kept->data();
  const py::capsule owner(kept.get(), [](void* of) { delete static_cast<std::vector<T>*>(of); });
  kept.release();
  if (wide == 1) return Array<T>(count, data, owner);
  return Array<T>({count, wide}, data, owner);
}

py::array visible_points(const Array<float>& direction, const Array<float>& map_direction,
                         const Array<std::int32_t>& face, const Array<float>& hit_m,
                         const Array<double>& origin_m, double range_m, double bearing_sine,
                         double elevation_sine) {
  const py::ssize_t count = face.size();
  require(direction.size() == 3 * count && map_direction.size() == 3 * count &&
              hit_m.size() == count && origin_m.size() == 3,
          "face, hit_m must be (N,), direction, map_direction (N, 3), origin_m (3,)");
  const double* o = origin_m.data();
  std::vector<double> points;
  {
    const py::gil_scoped_release unlocked;
    points = acoustics::visible_points({static_cast<std::size_t>(count),
                                        direction.data(),
                                        map_direction.data(),
                                        face.data(),
                                        hit_m.data(),
                                        {o[0], o[1], o[2]}},
                                       range_m, bearing_sine, elevation_sine);
  }
  points.shrink_to_fit();
  return rows_of(std::move(points), 3);
}

py::array cells_through_window(const Array<float>& direction, const Array<float>& cell,
                               const Array<double>& map_T_fan, const Array<double>& plane,
                               const Array<double>& box_m, double margin_m, double reach_m) {
  require(direction.ndim() == 2 && direction.shape(1) == 3, "direction must be (N, 3)");
  const py::ssize_t count = direction.shape(0);
  require(cell.size() == 4 * count, "cell must be (N, 4)");
  require(map_T_fan.size() == 12 && plane.size() == 4 && box_m.size() == 6,
          "map_T_fan must be (12,), plane (4,), box_m (2, 3)");
  const double* p = plane.data();
  const double* b = box_m.data();
  const acoustics::MirrorWindow window{transform_of(map_T_fan.data()),
                                       {p[0], p[1], p[2]},
                                       p[3],
                                       {b[0], b[1], b[2]},
                                       {b[3], b[4], b[5]},
                                       margin_m,
                                       reach_m};
  std::vector<std::int64_t> through;
  {
    const py::gil_scoped_release unlocked;
    through = acoustics::cells_through_window(
        {static_cast<std::size_t>(count), direction.data(), cell.data()}, window);
  }
  return Array<std::int64_t>(static_cast<py::ssize_t>(through.size()), through.data());
}

acoustics::SeenMesh mesh_view(const acoustics::MeshEdges& table, const Array<double>& pose) {
  require(pose.size() == 15, "pose must be rotation (9), origin (3), sonar (3)");
  const double* p = pose.data();
  acoustics::SeenMesh mesh{&table, {}, {p[9], p[10], p[11]}, {p[12], p[13], p[14]}};
  std::copy_n(p, 9, mesh.rotation.begin());
  return mesh;
}

acoustics::SoundLayers sound_layers(const Array<double>& table) {
  require(table.ndim() == 2 && table.shape(1) == 2, "layers must be (L, 2)");
  acoustics::SoundLayers layers;
  for (py::ssize_t i = 0; i < table.shape(0); ++i) {
    layers.depth_m.push_back(table.data()[2 * i]);
    layers.speed_mps.push_back(table.data()[2 * i + 1]);
  }
  return layers;
}

bool is_rows_of_three(const Array<double>& array) {
  return array.ndim() == 2 && array.shape(1) == 3;
}

acoustics::SoundLayers refracting_layers(const Array<double>& table) {
  acoustics::SoundLayers layers = sound_layers(table);
  require(!layers.depth_m.empty(), "layers must have a depth");
  return layers;
}

py::tuple turned_rays(const Array<double>& layers, const Array<double>& points,
                      const Array<double>& directions, double step_m, double turn_m,
                      unsigned threads) {
  require(is_rows_of_three(directions) && is_rows_of_three(points) &&
              points.shape(0) == directions.shape(0),
          "points and directions must be (N, 3)");
  const py::ssize_t count = directions.shape(0);
  const acoustics::SoundLayers refracting = refracting_layers(layers);
  Array<double> turned({count, py::ssize_t{3}}, directions.data());
  Array<double> speeds(count);
  double* to = turned.mutable_data();
  double* speed = speeds.mutable_data();
  {
    const py::gil_scoped_release unlocked;
    acoustics::turn_rays(refracting, static_cast<std::size_t>(count), points.data(), to, step_m,
                         turn_m, speed, threads);
  }
  return py::make_tuple(speeds, turned);
}

py::tuple followed_rays(const Array<double>& layers, const Array<double>& origin_m,
                        const Array<double>& directions, double step_m, std::size_t steps,
                        double speed_mps) {
  require(is_rows_of_three(directions) && origin_m.size() == 3,
          "origin_m must be (3,), directions (N, 3)");
  const py::ssize_t count = directions.shape(0);
  const acoustics::SoundLayers refracting = refracting_layers(layers);
  const auto rows = static_cast<py::ssize_t>(steps) + 1;
  std::vector<double> leaving(directions.data(), directions.data() + directions.size());
  Array<double> corners({rows, count, py::ssize_t{3}});
  Array<double> ranges({rows, count});
  double* to = corners.mutable_data();
  double* range_m = ranges.mutable_data();
  {
    const py::gil_scoped_release unlocked;
    acoustics::follow_rays(refracting, static_cast<std::size_t>(count), origin_m.data(),
                           leaving.data(), step_m, steps, speed_mps, to, range_m);
  }
  return py::make_tuple(corners, ranges);
}

py::tuple refined_rays(const Array<float>& direction, const Array<float>& cell,
                       const Array<float>& range_m, const Array<double>& row_edges,
                       const Array<std::int32_t>& rays, double first_s, double s_pitch,
                       const std::vector<acoustics::SeenMesh>& meshes,
                       const Array<std::int64_t>& pairs, double reach_m,
                       const Array<double>& layers, const Array<double>& up) {
  const py::ssize_t count = range_m.size();
  require(direction.size() == 3 * count && cell.size() == 4 * count,
          "direction must be (N, 3), cell (N, 4), range_m (N,)");
  require(rays.ndim() == 2 && row_edges.size() == rays.shape(1) + 1,
          "rays must be (columns, rows), row_edges (rows + 1,)");
  std::int32_t next = 0;
  const bool in_order = std::all_of(rays.data(), rays.data() + rays.size(),
                                    [&next](std::int32_t ray) { return ray < 0 || ray == next++; });
  require(in_order && next == count, "rays must name each ray once, in order");
  const std::int64_t* at = pairs.data();
  require(std::all_of(at, at + pairs.size(),
                      [count](std::int64_t ray) { return ray >= 0 && ray + 1 < count; }),
          "pair beyond the fan");
  const std::vector<std::int64_t> lower(at, at + pairs.size());
  require(up.size() == 4, "up must be (4,)");
  const acoustics::RefractionView view{
      sound_layers(layers), {up.data()[0], up.data()[1], up.data()[2]}, up.data()[3]};
  acoustics::RefinedRays found;
  {
    const py::gil_scoped_release unlocked;
    found = acoustics::refined_rays(
        {static_cast<std::size_t>(rays.shape(0)), static_cast<std::size_t>(rays.shape(1)), first_s,
         s_pitch, row_edges.data(), rays.data()},
        {static_cast<std::size_t>(count), range_m.data(), direction.data(), cell.data()}, meshes,
        lower, reach_m, view);
  }
  return py::make_tuple(rows_of(std::move(found.direction), 3), rows_of(std::move(found.cell), 4),
                        rows_of(std::move(found.lean), 2), rows_of(std::move(found.column), 1),
                        rows_of(std::move(found.from), 1));
}

}  // namespace

void bind_tracing(py::module_& module) {
  using py::arg;
  module.def("edges", &edges, arg("direction"), arg("range_m"), arg("face"), arg("group"),
             arg("standing"), arg("column"), arg("normals"), arg("smooth"), arg("max_slope"),
             arg("min_step_m"), arg("min_cosine"));
  module.def("spans", &spans, arg("range_m"), arg("face"), arg("column"), arg("up"), arg("surface"),
             arg("size_m"));
  py::class_<acoustics::MeshEdges>(module, "EdgeTable")
      .def(py::init(&edge_table), arg("corners_m"), arg("normals"), arg("surface"))
      .def("__len__", [](const acoustics::MeshEdges& table) { return table.edges.size(); });
  py::class_<TriangleTable>(module, "TriangleTable")
      .def(py::init(&triangle_table), arg("corners_m"))
      .def("cast_bundle", &cast_bundle, arg("origin_m"), arg("direction"), arg("near_m"),
           arg("first_face"), arg("range_m").noconvert(), arg("face").noconvert(), arg("threads"));
  py::class_<acoustics::SeenMesh>(module, "MeshView")
      .def(py::init(&mesh_view), arg("table"), arg("pose"), py::keep_alive<1, 2>());
  module.def("meet_sea", &meet_sea, arg("direction"), arg("depth_m"), arg("near_m"),
             arg("sea_face"), arg("sea_group"), arg("range_m").noconvert(), arg("face").noconvert(),
             arg("group").noconvert());
  module.def("merged", &merged, arg("known"), arg("source"), arg("more"));
  module.def("rotated", &rotated, arg("direction"), arg("matrix"));
  module.def("rays_near_ball", &rays_near_ball, arg("start_m"), arg("direction"), arg("reach_m"),
             arg("middle_m"), arg("radius_m"));
  module.def("visible_points", &visible_points, arg("direction"), arg("map_direction"), arg("face"),
             arg("hit_m"), arg("origin_m"), arg("range_m"), arg("bearing_sine"),
             arg("elevation_sine"));
  module.def("cells_through_window", &cells_through_window, arg("direction"), arg("cell"),
             arg("map_T_fan"), arg("plane"), arg("box_m"), arg("margin_m"), arg("reach_m"));
  module.def("turned_rays", &turned_rays, arg("layers"), arg("points"), arg("directions"),
             arg("step_m"), arg("turn_m"), arg("threads") = 2);
  module.def("followed_rays", &followed_rays, arg("layers"), arg("origin_m"), arg("directions"),
             arg("step_m"), arg("steps"), arg("speed_mps"));
  module.def("refined_rays", &refined_rays, arg("direction"), arg("cell"), arg("range_m"),
             arg("row_edges"), arg("rays"), arg("first_s"), arg("s_pitch"), arg("meshes"),
             arg("pairs"), arg("reach_m"), arg("layers"), arg("up"));
}
