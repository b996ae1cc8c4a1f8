// The reference's loops, plainly: what the filter's times are compared with.
#pragma once

#include <random>
#include <vector>

#include "mapperd/localization/beam_weight.hpp"
#include "mapperd/localization/field_weight.hpp"
#include "mapperd/localization/motion.hpp"

namespace plain {

using namespace mapperd;
using namespace mapperd::localization;

// A particle as the reference keeps it: translation and unit complex number.
struct State {
  double x, y, cosine, sine;
};

struct Cloud {
  std::vector<State> state;
  std::vector<double> weight;
};

Cloud cloud_of(const Particles& particles);

// Differential motion with three normal draws a particle.
void move(Cloud& cloud, const MotionDraws& draws, std::mt19937_64& generator);

// Likelihoods 1 + sum p^3 by the field: each end is moved, divided by the resolution, floored,
// looked up.
void weigh_field(Cloud& cloud, const GridFrame& frame, const std::vector<float>& field,
                 double outside, const std::vector<double>& x, const std::vector<double>& y);

// Likelihoods sum p^3 by ranges: a standard line of cells from the particle to the largest range.
void weigh_beams(Cloud& cloud, const OccupancyGrid& grid, const BeamModel& model,
                 const std::vector<double>& x, const std::vector<double>& y);

void normalise(Cloud& cloud);

// Independent draws by binary search in the sums of weights, each entered into a set of buckets,
// with as many samples as before.
void resample(Cloud& cloud, std::mt19937_64& generator);

// p of the distances from a queue that spreads from all obstacles to four neighbours and never
// revises a distance.
std::vector<float> field_of(const OccupancyGrid& grid, const HitModel& model);

}  // namespace plain
