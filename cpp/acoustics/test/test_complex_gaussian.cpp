#include <cmath>
#include <vector>

#include "mapperd/acoustics/complex_gaussian.hpp"
#include "testing.hpp"

namespace acoustics = mapperd::acoustics;

namespace {

std::vector<float> numbers(std::uint64_t key, std::size_t count) {
  std::vector<float> out(2 * count);
  acoustics::complex_gaussians(key, 0, count, out.data());
  return out;
}

// Mean of the products of two sequences of unit power, one of them ahead by a lag.
double correlation(const std::vector<float>& a, const std::vector<float>& b, std::size_t lag) {
  double sum = 0.0;
  const std::size_t count = a.size() - lag;
  for (std::size_t i = 0; i < count; ++i) {
    sum += static_cast<double>(a[i]) * static_cast<double>(b[i + lag]);
  }
  return 2.0 * sum / static_cast<double>(count);
}

TEST_CASE("one number of a key and a row of them are the same") {
  const std::vector<float> row = numbers(77, 1000);
  for (std::size_t i = 0; i < 1000; ++i) {
    const std::complex<float> one = acoustics::complex_gaussian(mapperd::mix(77) + i);
    CHECK((one.real() == row[2 * i] && one.imag() == row[2 * i + 1]));
  }
}

TEST_CASE("a row begun elsewhere carries on") {
  const std::vector<float> whole = numbers(5, 700);
  std::vector<float> rest(2 * 433);
  acoustics::complex_gaussians(5, 267, 433, rest.data());
  CHECK(std::equal(rest.begin(), rest.end(), whole.begin() + 2 * 267));
}

TEST_CASE("the parts are Gaussian with half a unit of power each") {
  const std::vector<float> parts = numbers(3, 500000);
  double powers[5] = {};
  for (const float part : parts) {
    double power = 1.0;
    for (double& sum : powers) sum += power *= static_cast<double>(part);
  }
  for (double& sum : powers) sum /= static_cast<double>(parts.size());
  CHECK(powers[0] == near(0.0, 0.003));
  CHECK(powers[1] == near(0.5, 0.003));
  CHECK(powers[2] == near(0.0, 0.005));
  CHECK(powers[3] == near(0.75, 0.01));  // 3 sigma^4
}

TEST_CASE("the power is exponential, out to its tail") {
  const std::vector<float> parts = numbers(4, 1000000);
  for (const double level : {0.1, 1.0, 3.0, 7.0, 10.0}) {
    double above = 0.0;
    for (std::size_t i = 0; i < parts.size(); i += 2) {
      const double re = static_cast<double>(parts[i]);
      const double im = static_cast<double>(parts[i + 1]);
      if (re * re + im * im > level) above += 1.0;
    }
    const double expected = 1e6 * std::exp(-level);
    CHECK(above == near(expected, 4.0 * std::sqrt(expected)));
  }
}

TEST_CASE("the eight octants come equally often and the angle within one is even") {
  const std::vector<float> parts = numbers(6, 800000);
  double counts[32] = {};
  for (std::size_t i = 0; i < parts.size(); i += 2) {
    const double turn =
        std::atan2(static_cast<double>(parts[i + 1]), static_cast<double>(parts[i])) /
            6.283185307179586 +
        0.5;
    counts[std::min(31, static_cast<int>(turn * 32.0))] += 1.0;
  }
  for (const double count : counts) CHECK(count == near(25000.0, 4.0 * std::sqrt(25000.0)));
}

TEST_CASE("neighbours, rows and keys are independent") {
  const std::vector<float> row = numbers(9, 200000);
  for (const std::size_t lag : {1U, 2U, 3U, 64U, 512U}) {
    CHECK(correlation(row, row, lag) == near(0.0, 0.008));
  }
  for (const std::uint64_t key : {std::uint64_t{8}, std::uint64_t{10}, std::uint64_t{9} << 32}) {
    CHECK(correlation(row, numbers(key, 200000), 0) == near(0.0, 0.008));
  }
}

TEST_CASE("the order of two keys matters") {
  CHECK(mapperd::joined(1, 2) != mapperd::joined(2, 1));
  CHECK(mapperd::joined(0, 0) != 0);
}

TEST_CASE("the rarest bits give finite numbers") {
  for (const std::uint32_t upper : {0U, 0xFFU, 0xFFFFFFFFU}) {
    for (const std::uint32_t lower : {0U, 0x1FFFFFU, 0xFFFFFFFFU}) {
      const acoustics::Gaussian number = acoustics::gaussian_of(upper, lower);
      CHECK((std::isfinite(number.re) && std::isfinite(number.im)));
    }
  }
}

}  // namespace
