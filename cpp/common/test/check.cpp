#include "check.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

namespace check {

namespace {

struct Case {
  std::string name;
  Body body;
};

std::vector<Case>& cases() {
  static std::vector<Case> all;
  return all;
}

int failures = 0;

}  // namespace

Register::Register(const char* name, Body body) { cases().push_back({name, body}); }

void fail(const char* file, int line, const char* what) {
  // A broken formula fails everywhere: the first few places tell enough.
  if (++failures <= 20) std::printf("%s:%d: %s\n", file, line, what);
}

void fail(const char* file, int line, const std::string& what) { fail(file, line, what.c_str()); }

void fail_near(const char* file, int line, const char* what, double actual, double expected) {
  fail(file, line,
       std::string(what) + " is " + std::to_string(actual) + ", expected " +
           std::to_string(expected));
}

int run(int part, int parts) {
  int ran = 0;
  for (std::size_t i = static_cast<std::size_t>(part); i < cases().size();
       i += static_cast<std::size_t>(parts), ++ran) {
    const Case& c = cases()[i];
    const int before = failures;
    try {
      c.body();
    } catch (const std::exception& error) {
      fail(c.name.c_str(), 0, std::string("unexpected exception: ") + error.what());
    }
    std::printf("%s %s\n", failures == before ? "ok  " : "FAIL", c.name.c_str());
  }
  std::printf("%d failures in %d cases\n", failures, ran);
  return failures == 0 ? 0 : 1;
}

std::size_t keep(const std::string& text) {
  std::vector<Case>& all = cases();
  const auto other = [&](const Case& c) { return c.name.find(text) == std::string::npos; };
  all.erase(std::remove_if(all.begin(), all.end(), other), all.end());
  return all.size();
}

bool sanitized() { return std::getenv("MAPPERD_ORACLE_SCENES") != nullptr; }

}  // namespace check
