// The main function of each test program. Options are those of doctest, e.g. --test-case='*text*'.
#define DOCTEST_CONFIG_IMPLEMENT
#include <doctest/doctest.h>

int main(int argc, char** argv) {
  doctest::Context context;
  context.setOption("abort-after", 20);  // a broken formula fails in every turn of a loop
  context.applyCommandLine(argc, argv);
  return context.run();
}
