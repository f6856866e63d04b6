// SH coefficients stored in 16 bits become Floats: half the memory of a frame's largest read.
//
// The kernel stores them as it computes; what narrower ones save and cost (ShStored in choices.hpp) is
// measured by `python -m pipeline.work_precision`.
#pragma once

#include "choices.hpp"
#include "vec.hpp"

namespace splat {

// Sixteen stored coefficients.
SPLAT_INLINE Float widened(const scalar* p) { return Float::load(p); }

#if !RASTERIZER_FLOAT64
using NativeNarrow = uint16_t __attribute__((vector_size(2 * kNativeLanes)));

// Register by register, each from as many 16-bit words.
template <class Widen>
SPLAT_INLINE Float widened_by(const void* p, Widen&& widen) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
        NativeNarrow words;
        std::memcpy(&words, static_cast<const uint16_t*>(p) + i * kNativeLanes, sizeof words);
        r.part[i] = widen(words);
    }
    return r;
}
SPLAT_INLINE Float widened(const Bfloat16* p) {
    return widened_by(
        p, [](NativeNarrow w) { return (NativeFloat)(__builtin_convertvector(w, NativeInt) << 16); });
}
SPLAT_INLINE Float widened(const Float16* p) {
    return widened_by(p, [](NativeNarrow w) {
#if SPLAT_AVX512
        return (NativeFloat)_mm512_cvtph_ps((__m256i)w);
#elif SPLAT_AVX2
        return (NativeFloat)_mm256_cvtph_ps((__m128i)w);
#else
        // Exponent and mantissa put where a float has them; the product makes up for the other bias and
        // normalises what was denormal. Infinity and NaN, which no parameter is, become numbers.
        const NativeInt i = __builtin_convertvector(w, NativeInt);
        const NativeFloat size = (NativeFloat)((i & 0x7fff) << 13) * 0x1p112f;
        return (NativeFloat)((NativeInt)size | (i & 0x8000) << 16);
#endif
    });
}
#endif

// The first `count` <= 16, zeros behind them.
SPLAT_INLINE Float first_widened(const scalar* p, int count) { return Float::load_first(p, count); }
template <class Narrow>
SPLAT_INLINE Float first_widened(const Narrow* p, int count) {
    Narrow lane[kLanes] = {};
    for (int i = 0; i < count; ++i) lane[i] = p[i];
    return widened(lane);
}

}  // namespace splat
