/// \file
/// \brief The receiver's chain after the beam former: gain, clip, gamma, quantiser.
///
/// \par Threads
/// Functions of their arguments: any thread may call them.
#pragma once

#include <cstddef>
#include <cstdint>

namespace mapperd::acoustics {

struct Receiver {
  const float* gain;  ///< amplitude of full scale per unit of a beam's amplitude, one a row
  float gamma;        ///< pixel is of the amplitude's power gamma
  bool clip;          ///< at full scale
};

/// Amplitudes of full scale of complex beams (parts 2) or of powers (parts 1), (rows, beams).
/// NaN counts as 0.
void amplitudes(const float* beams, std::size_t parts, std::size_t rows, std::size_t count,
                const Receiver& receiver, float* out, unsigned threads);

/// amplitude^gamma, clipped if the receiver clips; in place is allowed.
void curved(const float* amplitude, std::size_t count, const Receiver& receiver, float* out,
            unsigned threads);

/// The nearest integer to the scale's end times amplitude^gamma, and no more than that end.
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint8_t* out, unsigned threads);
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint16_t* out, unsigned threads);
void quantised(const float* amplitude, std::size_t count, const Receiver& receiver,
               std::uint32_t* out, unsigned threads);

}  // namespace mapperd::acoustics
