#include "mapperd/localization/distance_transform.hpp"

#include <algorithm>

#include "mapperd/common/parallel.hpp"
#include "mapperd/common/simd.hpp"

namespace mapperd::localization {
namespace {

constexpr std::int32_t kFarCells = 1 << 20;
constexpr std::size_t kRowsATask = 64;

// One row of distances along columns: one more than the row before's, 0 where marked.
MAPPERD_VECTORISED void count_on(const std::uint8_t* marked, const std::int32_t* before,
                                 std::int32_t* here, std::size_t columns) {
  for (std::size_t c = 0; c < columns; ++c) here[c] = marked[c] != 0 ? 0 : before[c] + 1;
}

MAPPERD_VECTORISED void count_back(const std::int32_t* after, std::int32_t* here,
                                   std::size_t columns) {
  for (std::size_t c = 0; c < columns; ++c) here[c] = std::min(here[c], after[c] + 1);
}

std::vector<std::int32_t> along_columns(const std::vector<std::uint8_t>& marked, std::size_t rows,
                                        std::size_t columns) {
  std::vector<std::int32_t> distance(rows * columns);
  const std::vector<std::int32_t> far(columns, kFarCells);
  for (std::size_t r = 0; r < rows; ++r) {
    const std::int32_t* before = r == 0 ? far.data() : &distance[(r - 1) * columns];
    count_on(&marked[r * columns], before, &distance[r * columns], columns);
  }
  for (std::size_t r = rows - 1; r-- > 0;) {
    count_back(&distance[(r + 1) * columns], &distance[r * columns], columns);
  }
  return distance;
}

// The parabolas (c - site)^2 + height that are the lowest somewhere in one row.
class RowEnvelope {
 public:
  explicit RowEnvelope(std::size_t columns)
      : site_(columns), height_(columns), from_(columns + 1) {}

  // Replaces distances along columns by squared distances.
  void transform(std::int32_t* row, std::int32_t columns, std::int32_t limit) {
    count_ = 0;
    for (std::int32_t c = 0; c < columns; ++c) {
      if (row[c] <= limit) add(c, row[c] * row[c], columns);
    }
    const std::int32_t most = limit >= 46340 ? kBeyond - 1 : limit * limit;
    std::int32_t c = 0;
    for (std::size_t k = 0; k < count_; ++k) {
      const std::int32_t end = k + 1 < count_ ? from_[k + 1] : columns;
      for (; c < end; ++c) {
        const std::int32_t offset = c - site_[k];
        const std::int32_t squared = offset * offset + height_[k];
        row[c] = squared <= most ? squared : kBeyond;
      }
    }
    if (count_ == 0) std::fill(row, row + columns, kBeyond);
  }

 private:
  void add(std::int32_t site, std::int32_t height, std::int32_t columns) {
    while (count_ > 0) {
      const std::size_t last = count_ - 1;
      // Up to this column the last parabola is not above the new one. Never negative sums: sites
      // grow, and where the new one is lower from the first column on, it takes the place.
      const std::int32_t apart = site - site_[last];
      const std::int32_t twice = (site + site_[last]) * apart + height - height_[last];
      const std::int32_t shared = twice >= 0 ? twice / (2 * apart) : -1;
      if (shared >= from_[last]) {
        if (shared + 1 >= columns) return;
        push(site, height, shared + 1);
        return;
      }
      --count_;
    }
    push(site, height, 0);
  }

  void push(std::int32_t site, std::int32_t height, std::int32_t from) {
    site_[count_] = site;
    height_[count_] = height;
    from_[count_] = from;
    ++count_;
  }

  std::vector<std::int32_t> site_, height_, from_;
  std::size_t count_ = 0;
};

}  // namespace

std::vector<std::int32_t> squared_distances(const std::vector<std::uint8_t>& marked,
                                            std::size_t rows, std::size_t columns,
                                            std::int32_t limit, int threads) {
  std::vector<std::int32_t> distance = along_columns(marked, rows, columns);
  const std::int32_t reach = std::min(limit, kFarCells - 1);
  run_parallel((rows + kRowsATask - 1) / kRowsATask, threads, [&](std::size_t task) {
    RowEnvelope envelope(columns);
    const std::size_t end = std::min(rows, (task + 1) * kRowsATask);
    for (std::size_t r = task * kRowsATask; r < end; ++r) {
      envelope.transform(&distance[r * columns], static_cast<std::int32_t>(columns), reach);
    }
  });
  return distance;
}

}  // namespace mapperd::localization
