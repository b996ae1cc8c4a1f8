#define MAPPERD_KERNELS plain
#define MAPPERD_KERNELS_NAME "plain"
#include "kernels_body.hpp"

namespace mapperd::map {

#ifdef MAPPERD_HAS_AVX2
namespace avx2 {
extern const Kernels kKernels;
}
#endif

const Kernels& plain_kernels() { return plain::kKernels; }

const Kernels& kernels() {
#ifdef MAPPERD_HAS_AVX2
  static const bool has_avx2 = __builtin_cpu_supports("avx2") != 0;
  if (has_avx2) return avx2::kKernels;
#endif
  return plain::kKernels;
}

}  // namespace mapperd::map
