// doctest, with what the tests of all libraries add to it.
#pragma once

#include <doctest/doctest.h>

#include <cmath>

/// Whether a sanitizer watches this build. Loops are shorter there; the release build judges
/// figures.
#ifdef MAPPERD_SANITIZED
inline constexpr bool kSanitized = true;
#else
inline constexpr bool kSanitized = false;
#endif

/// A number within an absolute tolerance: `CHECK(value == near(1.5, 1e-9))`. NaN is near nothing.
struct Near {
  double value;
  double tolerance;
};

inline Near near(double value, double tolerance) { return {value, tolerance}; }

inline bool operator==(double actual, const Near& expected) {
  return std::abs(actual - expected.value) <= expected.tolerance;
}

inline doctest::String toString(const Near& expected) {
  return doctest::toString(expected.value) + " +- " + doctest::toString(expected.tolerance);
}
