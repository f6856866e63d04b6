// Reciprocal, exp, exp2, log2, sine and cosine of a Float, by polynomials whose errors are given.
#pragma once

#include "numerical_choices.hpp"
#include "simd/vec.hpp"

namespace splat {

inline constexpr scalar kLog2E = 1.44269504088896341;
inline constexpr scalar kTwoPi = 6.28318530717958648;
// Adding and subtracting 1.5·2²³ rounds a float of magnitude below 2²² to the nearest integer. For a double
// it is 1.5·2⁵², below 2⁵¹.
inline constexpr scalar kRoundMagic = sizeof(scalar) == 4 ? 0x1.8p23 : 0x1.8p52;

SPLAT_INLINE Float round_to_integer(const Float& x) { return (x + Float(kRoundMagic)) - Float(kRoundMagic); }

// 1/a with a relative error of about 1e-7: an estimate and one Newton step. Takes a third of a division's
// time in the backward pass.
SPLAT_INLINE Float fast_inverse(const Float& a) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
#if SPLAT_AVX512
        NativeFloat guess = (NativeFloat)_mm512_rcp14_ps((__m512)a.part[i]);
#elif SPLAT_AVX2
        NativeFloat guess = (NativeFloat)_mm256_rcp_ps((__m256)a.part[i]);
#elif SPLAT_SSE2
        NativeFloat guess = (NativeFloat)_mm_rcp_ps((__m128)a.part[i]);
#else
        NativeFloat guess = 1.f / a.part[i];
#endif
        r.part[i] = guess * (2.f - a.part[i] * guess);
    }
    return r;
}

}  // namespace splat

#if RASTERIZER_FLOAT64
#include "simd/vec_math_double.hpp"
#else
namespace splat {

// 2^f by the minimax polynomial of degree 3, 4 or 5, with a relative error of 7.5e-5, 2.7e-6 or 2e-7. f is
// the distance from the integer below (with AVX-512, where one instruction gives it) or else from the nearest
// one.
template <int degree>
SPLAT_INLINE NativeFloat exp2_of_fraction(NativeFloat f) {
    static_assert(degree >= 3 && degree <= 5);
#if SPLAT_AVX512
    constexpr float c[3][6] = {
        {0.999925219f, 0.695833543f, 0.226067146f, 0.0780245302f, 0.f, 0.f},
        {1.00000259f, 0.693003834f, 0.241442758f, 0.0520114586f, 0.0135341689f, 0.f},
        {0.999999925f, 0.693153072f, 0.240153621f, 0.0558263126f, 0.00898934306f, 0.0018775763f}};
#else
    constexpr float c[3][6] = {
        {0.999928073f, 0.693260985f, 0.242611125f, 0.0551716703f, 0.f, 0.f},
        {0.999999261f, 0.693121815f, 0.240247448f, 0.0559178603f, 0.00957010208f, 0.f},
        {1.00000007f, 0.693146967f, 0.240221198f, 0.0555071287f, 0.00967554032f, 0.00132765996f}};
#endif
    NativeFloat p = f * c[degree - 3][degree] + c[degree - 3][degree - 1];
    for (int k = degree - 2; k >= 0; --k) p = p * f + c[degree - 3][k];
    return p;
}

// 2^x for -126 <= x <= 126. Below: 0 with AVX-512, undefined otherwise (callers mask it).
template <int degree>
SPLAT_INLINE Float exp2_poly(const Float& x) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
#if SPLAT_AVX512
        const __m512 v = (__m512)x.part[i];
        const NativeFloat p = exp2_of_fraction<degree>((NativeFloat)_mm512_reduce_ps(v, _MM_FROUND_FLOOR));
        r.part[i] = (NativeFloat)_mm512_scalef_ps((__m512)p, v);  // p · 2^floor(v)
#else
        const NativeFloat shifted = x.part[i] + kRoundMagic;
        const NativeFloat p = exp2_of_fraction<degree>(x.part[i] - (shifted - kRoundMagic));
        r.part[i] = (NativeFloat)((NativeInt)p + ((NativeInt)shifted << 23));
#endif
    }
    return r;
}

// log2 of a positive normal x, absolute error 1e-7: log2(m) = 2/ln 2 · atanh((m-1)/(m+1)), m in [√½, √2).
SPLAT_INLINE Float log2(const Float& x) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
        NativeInt b = (NativeInt)x.part[i];
        NativeInt exponent = (b - 0x3f3504f3) >> 23;
        NativeFloat m = (NativeFloat)(b - (exponent << 23));
        NativeFloat z = (m - 1.f) / (m + 1.f), z2 = z * z;
        NativeFloat series = z2 * 0.3205989f + 0.41219858f;
        series = series * z2 + 0.57707802f;
        series = series * z2 + 0.96179669f;
        series = series * z2 + 2.88539008f;
        r.part[i] = z * series + __builtin_convertvector(exponent, NativeFloat);
    }
    return r;
}

// cos(2πu) of u in turns: cos(2πu) = -sin(2π(|u - round(u)| - ¼)), sine by Taylor to degree 11 on [-π/2,
// π/2].
SPLAT_INLINE Float cos_turns(const Float& u) {
    Float y = (abs(u - round_to_integer(u)) - Float(0.25f)) * Float(kTwoPi);
    Float y2 = y * y;
    Float s = y2 * Float(-2.50521084e-8f) + Float(2.75573192e-6f);
    s = s * y2 + Float(-1.98412698e-4f);
    s = s * y2 + Float(8.33333333e-3f);
    s = s * y2 + Float(-1.66666667e-1f);
    return -(s * y2 * y + y);
}

}  // namespace splat
#endif

namespace splat {

SPLAT_INLINE Float sin_turns(const Float& u) { return cos_turns(u - Float(0.25f)); }

SPLAT_INLINE Float exp2(const Float& x) { return exp2_poly<5>(x); }
// The one for alpha (numerical_choices.hpp).
SPLAT_INLINE Float exp2_fast(const Float& x) { return exp2_poly<kAlphaExpDegree>(x); }

// e^x with x clamped to ±80, beyond every meaningful log scale and logit in float32; NaN counts as -80.
inline constexpr scalar kLargestExponent = 80.f;
SPLAT_INLINE Float exp(const Float& x) {
    return exp2(clamp(x, -kLargestExponent, kLargestExponent) * Float(kLog2E));
}

}  // namespace splat
