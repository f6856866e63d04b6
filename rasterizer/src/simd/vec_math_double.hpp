// exp2, log2 and cosine of sixteen doubles, by series accurate to a double's last digits.
#pragma once

namespace splat {

inline constexpr int kMantissaBits = 52;
inline constexpr double kLn2 = 0.69314718055994530942;

// Σ_k c[k] x^k
template <size_t terms>
SPLAT_INLINE NativeFloat polynomial(const double (&c)[terms], NativeFloat x) {
    NativeFloat p = x * c[terms - 1] + c[terms - 2];
    for (int k = static_cast<int>(terms) - 3; k >= 0; --k) p = p * x + c[k];
    return p;
}

// (ln 2)^k / k!: on [-½, ½] the terms left out of 2^f are below 1e-17.
inline constexpr struct Exp2Series {
    double c[14];
    constexpr Exp2Series() : c{1} {
        for (int k = 1; k < 14; ++k) c[k] = c[k - 1] * kLn2 / k;
    }
} kExp2Series;

// 2^x for -1022 <= x <= 1022, of the same accuracy for every `degree`; undefined beyond.
template <int degree>
SPLAT_INLINE Float exp2_poly(const Float& x) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
        const NativeFloat shifted = x.part[i] + kRoundMagic;
        const NativeFloat p = polynomial(kExp2Series.c, x.part[i] - (shifted - kRoundMagic));
        r.part[i] = (NativeFloat)((NativeInt)p + ((NativeInt)shifted << kMantissaBits));
    }
    return r;
}

// 2/ln 2 / (2k + 1), the series of 2/ln 2 · atanh(z) / z in z²: below 1e-17 from the 12th on where z² <=
// 0.0295.
inline constexpr struct Log2Series {
    double c[12];
    constexpr Log2Series() : c{} {
        for (int k = 0; k < 12; ++k) c[k] = 2 / kLn2 / (2 * k + 1);
    }
} kLog2Series;

// log2 of a positive normal x: log2(m) = 2/ln 2 · atanh((m-1)/(m+1)), m in [√½, √2).
SPLAT_INLINE Float log2(const Float& x) {
    constexpr int64_t kSqrtHalf = 0x3fe6a09e667f3bcd,
                      kMagic = 0x4338000000000000;  // √½ and kRoundMagic as bits
    Float r;
    for (int i = 0; i < kParts; ++i) {
        const NativeInt b = (NativeInt)x.part[i];
        const NativeInt exponent = (b - kSqrtHalf) >> kMantissaBits;
        const NativeFloat m = (NativeFloat)(b - (exponent << kMantissaBits));
        const NativeFloat z = (m - 1.0) / (m + 1.0);
        r.part[i] = z * polynomial(kLog2Series.c, z * z) + ((NativeFloat)(exponent + kMagic) - kRoundMagic);
    }
    return r;
}

// (-1)^k / (2k + 1)!, the series of sin(y) / y in y²: below 1e-17 from the 12th on where |y| <= π/2.
inline constexpr struct SineSeries {
    double c[12];
    constexpr SineSeries() : c{1} {
        for (int k = 1; k < 12; ++k) c[k] = -c[k - 1] / (2 * k * (2 * k + 1));
    }
} kSineSeries;

// cos(2πu) of u in turns: cos(2πu) = -sin(2π(|u - round(u)| - ¼)).
SPLAT_INLINE Float cos_turns(const Float& u) {
    const Float y = (abs(u - round_to_integer(u)) - Float(0.25)) * Float(kTwoPi);
    Float r;
    for (int i = 0; i < kParts; ++i)
        r.part[i] = -y.part[i] * polynomial(kSineSeries.c, y.part[i] * y.part[i]);
    return r;
}

}  // namespace splat
