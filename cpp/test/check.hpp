// The tests' harness: named cases, checks that print both sides, one line at the end.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <functional>
#include <string>
#include <utility>
#include <vector>

namespace check {

struct Case {
  std::string name;
  std::function<void()> body;
};

inline std::vector<Case>& cases() {
  static std::vector<Case> all;
  return all;
}
inline int& failures() {
  static int count = 0;
  return count;
}

struct Register {
  Register(std::string name, std::function<void()> body) {
    cases().push_back({std::move(name), std::move(body)});
  }
};

inline void fail(const char* file, int line, const std::string& what) {
  // A broken formula fails everywhere: the first few places tell enough.
  if (++failures() <= 20) std::printf("%s:%d: %s\n", file, line, what.c_str());
}

// Every `parts`-th case, beginning with one of the first: several processes share a suite.
inline int run(int part, int parts) {
  int ran = 0;
  for (std::size_t i = part; i < cases().size(); i += parts, ++ran) {
    const Case& c = cases()[i];
    const int before = failures();
    try {
      c.body();
    } catch (const std::exception& error) {
      fail(c.name.c_str(), 0, std::string("unexpected exception: ") + error.what());
    }
    std::printf("%s %s\n", failures() == before ? "ok  " : "FAIL", c.name.c_str());
  }
  std::printf("%d failures in %d cases\n", failures(), ran);
  return failures() == 0 ? 0 : 1;
}

// Leaves those whose names hold a text; returns how many are left.
inline std::size_t keep(const std::string& text) {
  std::vector<Case>& all = cases();
  const auto other = [&](const Case& c) { return c.name.find(text) == std::string::npos; };
  all.erase(std::remove_if(all.begin(), all.end(), other), all.end());
  return all.size();
}

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

#define CHECK_NEAR(actual, expected, tolerance)                                             \
  do {                                                                                      \
    const double check_a = (actual);                                                        \
    const double check_e = (expected);                                                      \
    if (!(std::abs(check_a - check_e) <= (tolerance))) {                                    \
      check::fail(__FILE__, __LINE__,                                                       \
                  std::string(#actual) + " is " + std::to_string(check_a) + ", expected " + \
                      std::to_string(check_e));                                             \
    }                                                                                       \
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
