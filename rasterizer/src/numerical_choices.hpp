// Numerical choices: each trades accuracy for time, and none is part of the model.
//
// The macros are for `python -m pipeline.studies.kernel_precision`, which builds the kernel with other values
// and measures what each costs and saves.
#pragma once

#include <cstdint>

#ifndef RASTERIZER_MIN_MARGINAL
#define RASTERIZER_MIN_MARGINAL 0.05
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

// The type of all arithmetic, and of all storage but 16-bit SH coefficients.
#if RASTERIZER_FLOAT64
using scalar = double;
#else
using scalar = float;
#endif

// ln x of x > 0, by ln x = 2 atanh((x - 1)/(x + 1)) on [¾, 1½]: std::log is not constexpr.
constexpr double constant_ln(double x) {
    double result = 0;
    for (; x < 0.75; x *= 2) result -= 0.69314718055994531;
    for (; x > 1.5; x /= 2) result += 0.69314718055994531;
    const double z = (x - 1) / (x + 1);
    double power = z;
    for (int k = 1; k < 40; k += 2, power *= z * z) result += 2 * power / k;
    return result;
}

// A Gaussian whose temporal marginal p(t) is lower is culled, as in the authors' code: 2.4 standard
// deviations from μt.
inline constexpr double kMinMarginal = RASTERIZER_MIN_MARGINAL;
// The test without an exponential: p(t) >= 0.05 ⟺ dt² <= this · Σtt.
inline constexpr scalar kMinusTwoLnMinMarginal = static_cast<scalar>(-2 * constant_ln(kMinMarginal));
inline constexpr scalar kLog2MinMarginal =
    static_cast<scalar>(constant_ln(kMinMarginal) / 0.69314718055994531);

// Contributions with a lower alpha are skipped, as in 3D Gaussian Splatting: a step of an 8-bit image. This
// bounds the ellipse of every splat, and so the number of (pixel, Gaussian) pairs to evaluate.
inline constexpr double kMinAlpha = RASTERIZER_MIN_ALPHA;
inline constexpr scalar kLog2MinAlpha = static_cast<scalar>(constant_ln(kMinAlpha) / 0.69314718055994531);

// Blending of a pixel stops before its transmittance falls below this, as in 3D Gaussian Splatting.
inline constexpr scalar kMinTransmittance = static_cast<scalar>(RASTERIZER_MIN_TRANSMITTANCE);

// Degree of the polynomial for 2^f in alpha. 4 has a relative error of 2.7e-6, under a thousandth of a step
// of an 8-bit image. In double there is one degree only.
inline constexpr int kAlphaExpDegree = RASTERIZER_EXP_DEGREE;

// Whether a splat intersects a block by its alpha >= 1/255 ellipse, or else by the ellipse's bounding box.
// The image is the same: blending tests each pixel again.
inline constexpr bool kExactCulling = RASTERIZER_EXACT_CULLING;
// Whether intersections are kept per 4×4 block, or else per tile. The image is the same.
inline constexpr bool kBlockMasks = RASTERIZER_BLOCK_MASKS;

// The storage type of SH coefficients, most of the memory that a view reads.
struct Float16 {  // IEEE binary16: 11 bits of precision, largest 65504
    uint16_t bits;
};
struct Bfloat16 {  // the upper half of a float: 8 bits of precision
    uint16_t bits;
};
using ShStored = RASTERIZER_SH_TYPE;
static_assert(!RASTERIZER_FLOAT64 || sizeof(ShStored) == sizeof(scalar));

}  // namespace splat
