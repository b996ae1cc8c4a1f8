// The tests' harness: named cases, checks that print both sides, one line at the end. What a check
// does when it fails stands in check.cpp: there are two thousand of them to compile.
#pragma once

#include <cmath>
#include <cstddef>
#include <exception>
#include <string>
#include <vector>

namespace check {

using Body = void (*)();

struct Register {
  Register(const char* name, Body body);
};

void fail(const char* file, int line, const char* what);
void fail(const char* file, int line, const std::string& what);
void fail_near(const char* file, int line, const char* what, double actual, double expected);

// Every `parts`-th case, beginning with one of the first: several processes share a suite.
int run(int part, int parts);

// Leaves those whose names hold a text; returns how many are left.
std::size_t keep(const std::string& text);

// A sanitizer's build walks the same ways fewer times: figures are the release's to judge.
bool sanitized();

}  // namespace check

#define CHECK_CONCAT_INNER(a, b) a##b
#define CHECK_CONCAT(a, b) CHECK_CONCAT_INNER(a, b)
#define TEST_CASE(name)                                                                          \
  static void CHECK_CONCAT(test_, __LINE__)();                                                   \
  static const check::Register CHECK_CONCAT(register_, __LINE__)(name,                           \
                                                                 CHECK_CONCAT(test_, __LINE__)); \
  static void CHECK_CONCAT(test_, __LINE__)()

#define CHECK(condition)                                           \
  do {                                                             \
    if (!(condition)) check::fail(__FILE__, __LINE__, #condition); \
  } while (false)

#define CHECK_NEAR(actual, expected, tolerance)                        \
  do {                                                                 \
    const double check_a = (actual);                                   \
    const double check_e = (expected);                                 \
    if (!(std::abs(check_a - check_e) <= (tolerance))) {               \
      check::fail_near(__FILE__, __LINE__, #actual, check_a, check_e); \
    }                                                                  \
  } while (false)

#define CHECK_THROWS(expression, exception)                                                        \
  do {                                                                                             \
    bool check_thrown = false;                                                                     \
    try {                                                                                          \
      static_cast<void>(expression);                                                               \
    } catch (const exception&) {                                                                   \
      check_thrown = true;                                                                         \
    }                                                                                              \
    if (!check_thrown) check::fail(__FILE__, __LINE__, #expression " does not throw " #exception); \
  } while (false)
