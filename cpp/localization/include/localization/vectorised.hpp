// Loops over particles that become vector code.
#pragma once

// Functions marked so are compiled for several machines and chosen between when loaded. Every
// version does the same operations in the same order (contraction is off): the same bits.
// Sanitizers do not work in such a choice, and other compilers do not know it.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
#define LOCALIZATION_VECTORISED __attribute__((target_clones("avx512f", "avx2", "default")))
#else
#define LOCALIZATION_VECTORISED
#endif
#if defined(__GNUC__)
#define LOCALIZATION_INLINE inline __attribute__((always_inline))
#else
#define LOCALIZATION_INLINE inline
#endif
