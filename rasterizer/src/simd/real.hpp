// Functions of Float for a single double too, so that templates over `Real` take both.
//
// Slice and projection are such templates: Float for sixteen Gaussians, double for the rare Gaussian whose
// rounding in float32 would be visible (needles of thousands of pixels, speeds of thousands of world units a
// duration).
#pragma once

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "simd/vec_math.hpp"

namespace splat {

inline double min(double a, double b) { return std::min(a, b); }
inline double max(double a, double b) { return std::max(a, b); }
inline double abs(double a) { return std::abs(a); }
inline double sqrt(double a) { return std::sqrt(a); }
inline double clamp(double a, double low, double high) { return std::min(std::max(a, low), high); }
inline double exp(double a) {  // clamped as Float's
    return std::exp(clamp(a, -static_cast<double>(kLargestExponent), static_cast<double>(kLargestExponent)));
}
inline unsigned bits(bool m) { return m; }
inline double select(bool m, double yes, double no) { return m ? yes : no; }
inline double zero_unless(bool m, double a) { return m ? a : 0.0; }

template <class Real>
using MaskOf = std::conditional_t<std::is_same_v<Real, double>, bool, Mask>;
template <class Real>
using ScalarOf = std::conditional_t<std::is_same_v<Real, double>, double, scalar>;

SPLAT_INLINE scalar lane_of(const Float& a, int lane) {
    alignas(64) scalar value[kLanes];
    a.store(value);
    return value[lane];
}
SPLAT_INLINE void set_lane(Float& a, int lane, double x) {
    alignas(64) scalar value[kLanes];
    a.store(value);
    value[lane] = static_cast<scalar>(x);
    a = Float::load(value);
}

}  // namespace splat
