// The numerical choices: each trades accuracy for time, and none is part of the model. `python -m
// pipeline.work_precision` builds the kernel with others (by the macros) and measures what each costs and
// saves.
#pragma once

#include <cstdint>

#ifndef RASTERIZER_MIN_PRESENCE
#define RASTERIZER_MIN_PRESENCE 0.05
#endif
#ifndef RASTERIZER_MIN_ALPHA
#define RASTERIZER_MIN_ALPHA (1.0 / 255)
#endif
#ifndef RASTERIZER_MIN_TRANSMITTANCE
#define RASTERIZER_MIN_TRANSMITTANCE 1e-4
#endif
#ifndef RASTERIZER_EXP_DEGREE
#define RASTERIZER_EXP_DEGREE 4
#endif
#ifndef RASTERIZER_EXACT_CULLING
#define RASTERIZER_EXACT_CULLING 1
#endif
#ifndef RASTERIZER_BLOCK_MASKS
#define RASTERIZER_BLOCK_MASKS 1
#endif
#ifndef RASTERIZER_FLOAT64
#define RASTERIZER_FLOAT64 0
#endif
#ifndef RASTERIZER_SH_TYPE
#define RASTERIZER_SH_TYPE scalar
#endif

namespace splat {

// What everything is computed with and, but for narrow SH coefficients, stored in.
#if RASTERIZER_FLOAT64
using scalar = double;
#else
using scalar = float;
#endif

// ln x of a positive x, by halving to [¾, 1½] and ln x = 2 atanh((x - 1)/(x + 1)): std::log is not constexpr.
constexpr double constant_ln(double x) {
    double result = 0;
    for (; x < 0.75; x *= 2) result -= 0.69314718055994531;
    for (; x > 1.5; x /= 2) result += 0.69314718055994531;
    const double z = (x - 1) / (x + 1);
    double power = z;
    for (int k = 1; k < 40; k += 2, power *= z * z) result += 2 * power / k;
    return result;
}

// p(t) below this takes no part in the frame (the paper's program): 2.4 standard deviations from its moment.
inline constexpr double kMinPresence = RASTERIZER_MIN_PRESENCE;
// As it is tested: p(t) >= 0.05 ⟺ dt² <= this · Σtt, no exponential needed.
inline constexpr scalar kMinusTwoLogMinPresence = static_cast<scalar>(-2 * constant_ln(kMinPresence));
inline constexpr scalar kLog2MinPresence =
    static_cast<scalar>(constant_ln(kMinPresence) / 0.69314718055994531);

// Fainter contributions are skipped: a step of an 8-bit image (3D Gaussian Splatting). It bounds every splat,
// so it decides how many (pixel, Gaussian) pairs there are.
inline constexpr double kMinAlpha = RASTERIZER_MIN_ALPHA;
inline constexpr scalar kLog2MinAlpha = static_cast<scalar>(constant_ln(kMinAlpha) / 0.69314718055994531);

// A pixel ends before its transmittance falls below: what lies behind is invisible (3D Gaussian Splatting).
inline constexpr scalar kMinTransmittance = static_cast<scalar>(RASTERIZER_MIN_TRANSMITTANCE);

// Of alpha's 2^f: 4 errs by 2.7e-6 of alpha, under a thousandth of the smallest step an 8-bit image shows.
// Doubles have one degree alone.
inline constexpr int kAlphaExpDegree = RASTERIZER_EXP_DEGREE;

// Which blocks an entry marks: those that the alpha >= 1/255 ellipse touches, else those that the rectangle
// round it does. The same image: pixels are tested again one by one.
inline constexpr bool kExactCulling = RASTERIZER_EXACT_CULLING;
// A mask says which 4×4 blocks of the tile are touched, else only whether the tile is. The same image, too.
inline constexpr bool kBlockMasks = RASTERIZER_BLOCK_MASKS;

// What the SH coefficients, most of the memory a frame reads, are stored in.
struct Float16 {  // IEEE binary16: 11 bits of precision, largest 65504
    uint16_t bits;
};
struct Bfloat16 {  // the upper half of a float: 8 bits of precision
    uint16_t bits;
};
using ShStored = RASTERIZER_SH_TYPE;
static_assert(!RASTERIZER_FLOAT64 || sizeof(ShStored) == sizeof(scalar));

}  // namespace splat
