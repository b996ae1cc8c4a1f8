// Compiled with -mavx2; called only where the processor has it.
#define MAPPERD_KERNELS avx2
#define MAPPERD_KERNELS_NAME "avx2"
#include "kernels_body.hpp"
