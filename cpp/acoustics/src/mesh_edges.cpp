#include "mapperd/acoustics/mesh_edges.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <unordered_map>

#include "mapperd/common/vec.hpp"
#include "morton.hpp"

namespace mapperd::acoustics {

namespace {

constexpr float kFlat = 1.0F - 1e-6F;  // cosine between the normals of faces of one plane
constexpr float kCrease = 0.9F;        // and of a crease, at most

using Place = std::array<std::uint32_t, 3>;  // bits of a corner's coordinates

struct PlaceHash {
  std::size_t operator()(const Place& place) const {
    std::uint64_t hash = 0;
    for (const std::uint32_t word : place) {
      hash = (hash ^ word) * 0x9E3779B97F4A7C15ULL;
      hash ^= hash >> 29;
    }
    return static_cast<std::size_t>(hash);
  }
};

Place place_of(const float* corner_m) {
  const float plain[3] = {corner_m[0] + 0.0F, corner_m[1] + 0.0F, corner_m[2] + 0.0F};  // no -0
  Place place;
  std::memcpy(place.data(), plain, sizeof plain);
  return place;
}

std::vector<std::uint32_t> joined_corners(const float* corners_m, std::size_t count) {
  std::unordered_map<Place, std::uint32_t, PlaceHash> known;
  known.reserve(count);
  std::vector<std::uint32_t> names(count);
  for (std::size_t i = 0; i < count; ++i) {
    const auto next = static_cast<std::uint32_t>(known.size());
    names[i] = known.emplace(place_of(corners_m + 3 * i), next).first->second;
  }
  return names;
}

// A side of a face, by its corners' names in ascending order.
struct Side {
  std::uint64_t name;
  std::uint32_t face, corner;  // it begins at this corner of the face
};

std::vector<Side> sides_of(const std::vector<std::uint32_t>& names) {
  std::vector<Side> sides;
  sides.reserve(names.size());
  for (std::uint32_t face = 0; face < names.size() / 3; ++face) {
    for (std::uint32_t k = 0; k < 3; ++k) {
      const std::uint64_t a = names[3 * face + k];
      const std::uint64_t b = names[3 * face + (k + 1) % 3];
      sides.push_back({std::min(a, b) << 32 | std::max(a, b), face, k});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Side& a, const Side& b) {
    return a.name != b.name ? a.name < b.name : a.face < b.face;
  });
  return sides;
}

// Sorts edges so that those near each other follow one another.
void sort_by_place(std::vector<MeshEdge>& edges) {
  std::vector<float> places;
  places.reserve(3 * edges.size());
  for (const MeshEdge& edge : edges) {
    places.insert(places.end(), edge.end_m[0], edge.end_m[0] + 3);
  }
  std::vector<MeshEdge> sorted;
  sorted.reserve(edges.size());
  for (const std::uint32_t at : morton_order(places.data(), edges.size())) {
    sorted.push_back(edges[at]);
  }
  edges.swap(sorted);
}

EdgeBlock block_of(const std::vector<MeshEdge>& edges, std::size_t first, std::size_t last) {
  EdgeBlock block{first, last, {}, 0.0F, {}, 1.0F, true};
  for (std::size_t i = first; i < last; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      block.centre_m[k] +=
          (edges[i].end_m[0][k] + edges[i].end_m[1][k]) / static_cast<float>(2 * (last - first));
      block.axis[k] += edges[i].plane[0][k] + edges[i].plane[1][k];
    }
    block.smooth = block.smooth && !edges[i].border && !edges[i].crease;
  }
  const auto length = [](const float* v) {
    return std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  };
  const float scale = 1.0F / std::max(length(block.axis), 1e-9F);
  for (float& axis : block.axis) axis *= scale;
  for (std::size_t i = first; i < last; ++i) {
    for (std::size_t side = 0; side < 2; ++side) {
      const float* end = edges[i].end_m[side];
      const float away[3] = {end[0] - block.centre_m[0], end[1] - block.centre_m[1],
                             end[2] - block.centre_m[2]};
      block.radius_m = std::max(block.radius_m, length(away));
      const float* n = edges[i].plane[side];
      block.cosine = std::min(block.cosine,
                              n[0] * block.axis[0] + n[1] * block.axis[1] + n[2] * block.axis[2]);
    }
  }
  return block;
}

}  // namespace

MeshEdges mesh_edges(const float* corners_m, const float* normals, const std::int32_t* surface,
                     std::size_t count) {
  constexpr std::size_t kBlock = 64;
  const std::vector<Side> sides = sides_of(joined_corners(corners_m, 3 * count));
  MeshEdges mesh;
  for (std::size_t first = 0, end = 0; first < sides.size(); first = end) {
    end = first + 1;
    while (end < sides.size() && sides[end].name == sides[first].name) ++end;
    const Side& side = sides[first];
    const std::size_t a = side.face;
    const std::size_t b = end - first == 2 ? sides[first + 1].face : a;
    MeshEdge edge{};
    edge.border = a == b;
    const float* faces[2] = {normals + 3 * a, normals + 3 * b};
    const float* corner = corners_m + 9 * a;
    std::memcpy(edge.end_m[0], corner + 3 * side.corner, sizeof edge.end_m[0]);
    std::memcpy(edge.end_m[1], corner + 3 * ((side.corner + 1) % 3), sizeof edge.end_m[1]);
    std::memcpy(edge.inner_m, corner + 3 * ((side.corner + 2) % 3), sizeof edge.inner_m);
    for (std::size_t k = 0; k < 2; ++k) {
      std::copy_n(faces[k], 3, edge.plane[k]);
      edge.plane[k][3] = dot3(faces[k], edge.end_m[0]);
    }
    if (!edge.border) {
      const float cosine = dot3(faces[0], faces[1]);
      if (cosine > kFlat && surface[a] == surface[b]) continue;
      edge.crease = cosine < kCrease || surface[a] != surface[b];
      edge.round = !edge.crease;
    }
    mesh.edges.push_back(edge);
  }
  sort_by_place(mesh.edges);
  for (std::size_t first = 0; first < mesh.edges.size(); first += kBlock) {
    mesh.blocks.push_back(block_of(mesh.edges, first, std::min(first + kBlock, mesh.edges.size())));
  }
  return mesh;
}

}  // namespace mapperd::acoustics
