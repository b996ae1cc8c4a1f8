// The blocks of a map, in the order of their making.
#pragma once

#include <cstddef>
#include <utility>
#include <vector>

#include "mapperd/block.hpp"
#include "mapperd/memory_use.hpp"

namespace mapperd {

// As a std::deque, references stay valid while blocks are added; unlike there it is known what
// memory it takes, and it is given back.
class BlockStore {
 public:
  std::size_t size() const { return size_; }
  Block& operator[](std::size_t i) { return chunks_[i / kChunk][i % kChunk]; }
  const Block& operator[](std::size_t i) const { return chunks_[i / kChunk][i % kChunk]; }

  Block& add(const BlockKey& key) {
    if (size_ == kChunk * chunks_.size()) {
      std::vector<Block> chunk;
      chunk.reserve(kChunk);
      chunks_.push_back(std::move(chunk));
    }
    Block& block = chunks_.back().emplace_back(key);
    ++size_;
    return block;
  }

  // Of the blocks and what they hold.
  std::size_t memory_bytes() const {
    std::size_t bytes = allocated_by(chunks_);
    for (const std::vector<Block>& chunk : chunks_) {
      bytes += allocated_by(chunk);
      for (const Block& block : chunk) bytes += block.voxel_bytes();
    }
    return bytes;
  }

 private:
  static constexpr std::size_t kChunk = 32;

  std::vector<std::vector<Block>> chunks_;  // all but the last are full
  std::size_t size_ = 0;
};

}  // namespace mapperd
