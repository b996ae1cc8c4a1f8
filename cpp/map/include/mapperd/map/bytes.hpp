/// \file
/// \brief Little-endian numbers in and out of bytes, and the checksum over them.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <string>
#include <string_view>
#include <type_traits>

namespace mapperd::map {

/// To and from bytes that are known to be there: compilers make one move of each loop.
template <typename T>
void write_number(char* at, T value) {
  static_assert(std::is_integral_v<T>);
  const auto bits = static_cast<std::make_unsigned_t<T>>(value);
  for (unsigned i = 0; i < sizeof(T); ++i) at[i] = static_cast<char>(bits >> (8 * i) & 0xFFU);
}

template <typename T>
T read_number(const char* at) {
  static_assert(std::is_integral_v<T>);
  std::uint64_t bits = 0;
  for (unsigned i = 0; i < sizeof(T); ++i) {
    bits |= std::uint64_t{static_cast<unsigned char>(at[i])} << (8 * i);
  }
  return static_cast<T>(static_cast<std::make_unsigned_t<T>>(bits));
}

template <typename T>
void put(std::string& out, T value) {
  out.resize(out.size() + sizeof(T));
  write_number(&out[out.size() - sizeof(T)], value);
}

inline void put(std::string& out, double value) {
  std::uint64_t bits = 0;
  std::memcpy(&bits, &value, sizeof bits);
  put(out, bits);
}

/// Reads from front to back; throws std::invalid_argument, with the place, where bytes are missing.
class ByteReader {
 public:
  explicit ByteReader(std::string_view bytes) : bytes_(bytes) {}

  std::size_t at() const { return at_; }
  std::size_t left() const { return bytes_.size() - at_; }

  std::string_view take(std::size_t count) {
    if (left() < count) refuse("the data end too early");
    at_ += count;
    return bytes_.substr(at_ - count, count);
  }

  template <typename T>
  T get() {
    return read_number<T>(take(sizeof(T)).data());  // NOLINT(bugprone-suspicious-stringview*)
  }

  double get_double() {
    const auto bits = get<std::uint64_t>();
    double value = 0.0;
    std::memcpy(&value, &bits, sizeof value);
    return value;
  }

  [[noreturn]] void refuse(const std::string& what) const {
    throw std::invalid_argument("byte " + std::to_string(at_) + ": " + what);
  }

 private:
  std::string_view bytes_;
  std::size_t at_ = 0;
};

/// CRC-32 of IEEE 802.3 (reflected polynomial EDB88320), as zlib computes it.
std::uint32_t crc32(std::string_view bytes);

}  // namespace mapperd::map
