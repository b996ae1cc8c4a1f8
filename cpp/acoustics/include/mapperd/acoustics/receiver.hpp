/// \file
/// \brief The receiver after the beam former: gain, clipping, gamma, quantisation.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::acoustics {

/// How amplitudes become pixels.
struct Receiver {
  const float* gain;  ///< full-scale amplitude per unit of a beam's amplitude, one per row
  float gamma;        ///< a pixel is amplitude^gamma
  bool clip;          ///< at full scale
};

/// Amplitudes of full scale of complex beams (parts 2) or of powers (parts 1), (rows, beams).
/// NaN counts as 0.
void amplitudes(const float* beams, std::size_t parts, std::size_t rows, std::size_t count,
                const Receiver& receiver, float* out, unsigned threads);

/// amplitude^gamma, clipped if the receiver clips; in place is allowed.
void apply_gamma(const float* amplitude, std::size_t count, const Receiver& receiver, float* out,
                 unsigned threads);

/// Nearest integer to the maximum value times amplitude^gamma, limited to that maximum.
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint8_t* out, unsigned threads);
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint16_t* out, unsigned threads);
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint32_t* out, unsigned threads);

}  // namespace mapperd::acoustics
