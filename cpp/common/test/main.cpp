#include <cstdio>
#include <cstdlib>

#include "check.hpp"

// Without arguments all cases; with `TEXT` those whose names hold it; with `PART PARTS`, counted
// from 0, its share of them.
int main(int count, char** words) {
  if (count == 2 && check::keep(words[1]) == 0) {
    std::printf("no case has \"%s\" in its name\n", words[1]);
    return 2;
  }
  if (count != 3) return check::run(0, 1);
  return check::run(std::atoi(words[1]), std::atoi(words[2]));
}
