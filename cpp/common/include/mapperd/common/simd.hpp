/// \file
/// \brief Loops that the compiler turns into vector code.
#pragma once

/// Functions marked MAPPERD_VECTORISED are compiled with AVX-512, with AVX2 and with neither, and
/// chosen between when loaded. Every version does the same operations in the same order
/// (contraction is off): the same bits. Sanitizers do not support such a choice, and other
/// compilers do not know it.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define MAPPERD_VECTORISED __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define MAPPERD_VECTORISED
#endif

/// Before a loop: no iteration reads or writes what another one writes. The compiler then need not
/// prove it of the arrays that references lead to.
#if defined(__GNUC__) && !defined(__clang__)
#define MAPPERD_INDEPENDENT _Pragma("GCC ivdep")
#else
#define MAPPERD_INDEPENDENT
#endif

/// Functions that such loops call.
#if defined(__GNUC__)
#define MAPPERD_INLINE inline __attribute__((always_inline))
#else
#define MAPPERD_INLINE inline
#endif
