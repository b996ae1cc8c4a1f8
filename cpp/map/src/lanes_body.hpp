// Vectors of 8 and 16 numbers and the operations that the kernels need on them, for one target;
// with kernels_body.hpp included once per target, in the namespace MAPPERD_KERNELS. Every target
// computes the same bits.
#if defined(__AVX2__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#include <cstdint>

// Lanes of two vectors by constant indices. GCC has the first builtin from version 12 on.
#undef MAPPERD_SHUFFLE
#if defined(__clang__)
#define MAPPERD_SHUFFLE(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define MAPPERD_SHUFFLE(a, b, ...) __builtin_shuffle(a, b, I8{__VA_ARGS__})
#endif

namespace mapperd::map {
namespace MAPPERD_KERNELS {
namespace {

template <typename T, int kLanes>
struct VectorOf {
  typedef T type __attribute__((vector_size(sizeof(T) * kLanes)));
};
template <typename T, int kLanes>
using Vector = typename VectorOf<T, kLanes>::type;

using F8 = Vector<float, 8>;
using I8 = Vector<std::int32_t, 8>;
using S16 = Vector<std::int16_t, 16>;
using U16 = Vector<std::uint16_t, 16>;
using B16 = Vector<std::uint8_t, 16>;
using B8 = Vector<std::uint8_t, 8>;
using S8 = Vector<std::int16_t, 8>;
using U8 = Vector<std::uint16_t, 8>;

template <typename V, typename T>
inline V load(const T* values) {
  V lanes;
  __builtin_memcpy(&lanes, values, sizeof lanes);
  return lanes;
}

template <typename V, typename T>
inline void store(V lanes, T* values) {
  __builtin_memcpy(values, &lanes, sizeof lanes);
}

template <typename V>
inline V smaller(V a, V b) {
  return a < b ? a : b;
}
template <typename V>
inline V larger(V a, V b) {
  return a > b ? a : b;
}
inline float smaller(float a, float b) { return a < b ? a : b; }
inline float larger(float a, float b) { return a > b ? a : b; }
inline F8 all(float value) { return F8{} + value; }
inline S16 all16(std::int16_t value) { return S16{} + value; }
inline I8 truncated(F8 a) { return __builtin_convertvector(a, I8); }

inline F8 absolute(F8 a) { return a < 0.0F ? -a : a; }

inline F8 root(F8 a) {
#if defined(__AVX2__)
  return _mm256_sqrt_ps(a);
#else
  for (int i = 0; i < 8; ++i) a[i] = __builtin_sqrtf(a[i]);
  return a;
#endif
}

inline bool any(S16 mask) {
#if defined(__AVX2__)
  return _mm256_movemask_epi8(reinterpret_cast<__m256i>(mask)) != 0;
#else
  const auto words = reinterpret_cast<Vector<std::int64_t, 4>>(mask);
  return (words[0] | words[1] | words[2] | words[3]) != 0;
#endif
}

inline S16 widened(B16 bytes) {
#if defined(__AVX2__)
  return reinterpret_cast<S16>(_mm256_cvtepu8_epi16(reinterpret_cast<__m128i>(bytes)));
#else
  return __builtin_convertvector(bytes, S16);
#endif
}

// Sixteen numbers from 0 to 32767.
inline S16 joined(I8 low, I8 high) {
#if defined(__AVX2__)
  const __m256i packed =
      _mm256_packus_epi32(reinterpret_cast<__m256i>(low), reinterpret_cast<__m256i>(high));
  return reinterpret_cast<S16>(_mm256_permute4x64_epi64(packed, 0xD8));
#else
  const S8 halves[2] = {__builtin_convertvector(low, S8), __builtin_convertvector(high, S8)};
  return load<S16>(halves);
#endif
}

inline F8 eight_floats(const std::uint8_t* counts) {
#if defined(__AVX2__)
  return _mm256_cvtepi32_ps(
      _mm256_cvtepu8_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(counts))));
#else
  return __builtin_convertvector(__builtin_convertvector(load<B8>(counts), I8), F8);
#endif
}

inline F8 eight_floats(const std::uint16_t* counts) {
  return __builtin_convertvector(__builtin_convertvector(load<U8>(counts), I8), F8);
}

// Visits the lanes of a mask.
template <typename Visit>
inline void for_each_lane(S16 mask, const Visit& visit) {
#if defined(__AVX2__)
  auto bits = static_cast<unsigned>(_mm256_movemask_epi8(reinterpret_cast<__m256i>(mask)));
  for (bits &= 0x55555555U; bits != 0; bits &= bits - 1) visit(__builtin_ctz(bits) / 2);
#else
  std::int16_t lanes[16];
  store(mask, lanes);
  for (int i = 0; i < 16; ++i) {
    if (lanes[i] != 0) visit(i);
  }
#endif
}

inline std::int16_t multiply_q15(std::int16_t a, std::int16_t b) {
  return static_cast<std::int16_t>((std::int32_t{a} * b + 0x4000) >> 15);
}

inline S16 multiply_q15(S16 a, S16 b) {
#if defined(__AVX2__)
  return reinterpret_cast<S16>(
      _mm256_mulhrs_epi16(reinterpret_cast<__m256i>(a), reinterpret_cast<__m256i>(b)));
#elif defined(__aarch64__)
  int16x8_t x[2], y[2];
  __builtin_memcpy(x, &a, sizeof a);
  __builtin_memcpy(y, &b, sizeof b);
  const int16x8_t product[2] = {vqrdmulhq_s16(x[0], y[0]), vqrdmulhq_s16(x[1], y[1])};
  return load<S16>(product);
#else
  using Wide = Vector<std::int32_t, 16>;
  const Wide product = __builtin_convertvector(a, Wide) * __builtin_convertvector(b, Wide);
  return __builtin_convertvector((product + 0x4000) >> 15, S16);
#endif
}

inline bool any(I8 mask) {
#if defined(__AVX2__)
  return _mm256_movemask_epi8(reinterpret_cast<__m256i>(mask)) != 0;
#else
  const auto words = reinterpret_cast<Vector<std::int64_t, 4>>(mask);
  return (words[0] | words[1] | words[2] | words[3]) != 0;
#endif
}

// Eight numbers of -1 to 255 as bytes.
inline std::uint64_t bytes_of(I8 a) {
#if defined(__AVX2__)
  const __m256i words = _mm256_and_si256(reinterpret_cast<__m256i>(a), _mm256_set1_epi32(0xFF));
  const __m128i halves =
      _mm_packus_epi32(_mm256_castsi256_si128(words), _mm256_extracti128_si256(words, 1));
  return static_cast<std::uint64_t>(_mm_cvtsi128_si64(_mm_packus_epi16(halves, halves)));
#else
  const auto bytes = __builtin_convertvector(a, B8);
  std::uint64_t packed;
  __builtin_memcpy(&packed, &bytes, sizeof packed);
  return packed;
#endif
}

}  // namespace
}  // namespace MAPPERD_KERNELS
}  // namespace mapperd::map
