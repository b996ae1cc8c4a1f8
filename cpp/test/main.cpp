#include <cstdlib>

#include "check.hpp"

// Without arguments all cases; with `PART PARTS`, counted from 0, its share of them.
int main(int count, char** words) {
  if (count != 3) return check::run(0, 1);
  return check::run(std::atoi(words[1]), std::atoi(words[2]));
}
