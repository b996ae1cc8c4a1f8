/// \file
/// \brief The blocks of a map, unordered.
///
/// \par Threads
/// Not locked: the caller holds a lock of the map if other threads use it.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "mapperd/common/memory_use.hpp"
#include "mapperd/map/block.hpp"

namespace mapperd::map {

/// Like in a std::deque, references stay valid while blocks are added. In addition the memory is
/// known and can be released.
class BlockStore {
 public:
  std::size_t size() const { return size_; }
  Block& operator[](std::size_t i) { return chunks_[i / kChunk][i % kChunk]; }
  const Block& operator[](std::size_t i) const { return chunks_[i / kChunk][i % kChunk]; }

  Block& add(const Block& block) {
    if (size_ == kChunk * chunks_.size()) {
      std::vector<Block> chunk;
      chunk.reserve(kChunk);
      chunks_.push_back(std::move(chunk));
    }
    Block& added = chunks_.back().emplace_back(block);
    ++size_;
    return added;
  }

  /// Keeps some blocks and frees the memory of the others. Invalidates references to blocks.
  template <typename Keep>  // bool(const Block&)
  void keep_if(const Keep& keep) {
    BlockStore kept;
    for (std::vector<Block>& chunk : chunks_) {
      for (Block& block : chunk) {
        if (keep(block)) kept.add(block);
      }
      std::vector<Block>().swap(chunk);
    }
    *this = std::move(kept);
  }

  /// Bytes, without the voxels that the pool holds.
  std::size_t memory_bytes() const {
    std::size_t bytes = allocated_by(chunks_);
    for (const std::vector<Block>& chunk : chunks_) bytes += allocated_by(chunk);
    return bytes;
  }

 private:
  static constexpr std::size_t kChunk = 32;

  std::vector<std::vector<Block>> chunks_;  ///< all but the last are full
  std::size_t size_ = 0;
};

}  // namespace mapperd::map
