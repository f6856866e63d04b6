// Loads SH coefficients, stored in 16 or 32 bits, as Floats.
//
// By default they are stored as `scalar`. What 16-bit storage saves and costs (ShStored in
// numerical_choices.hpp) is measured by `python -m pipeline.studies.kernel_precision`.
#pragma once

#include "numerical_choices.hpp"
#include "simd/vec.hpp"

namespace splat {

// Sixteen stored coefficients.
SPLAT_INLINE Float load_as_float(const scalar* p) { return Float::load(p); }

#if !RASTERIZER_FLOAT64
using NativeHalf = uint16_t __attribute__((vector_size(2 * kNativeLanes)));

// One native register at a time, each from as many 16-bit words.
template <class Widen>
SPLAT_INLINE Float load_converted(const void* p, Widen&& widen) {
    Float r;
    for (int i = 0; i < kParts; ++i) {
        NativeHalf words;
        std::memcpy(&words, static_cast<const uint16_t*>(p) + i * kNativeLanes, sizeof words);
        r.part[i] = widen(words);
    }
    return r;
}
SPLAT_INLINE Float load_as_float(const Bfloat16* p) {
    return load_converted(
        p, [](NativeHalf w) { return (NativeFloat)(__builtin_convertvector(w, NativeInt) << 16); });
}
SPLAT_INLINE Float load_as_float(const Float16* p) {
    return load_converted(p, [](NativeHalf w) {
#if SPLAT_AVX512
        return (NativeFloat)_mm512_cvtph_ps((__m256i)w);
#elif SPLAT_AVX2
        return (NativeFloat)_mm256_cvtph_ps((__m128i)w);
#else
        // Exponent and mantissa are moved to a float's places. The product corrects the exponent's bias and
        // normalises denormals. Infinity and NaN would become numbers, but no parameter is either.
        const NativeInt i = __builtin_convertvector(w, NativeInt);
        const NativeFloat size = (NativeFloat)((i & 0x7fff) << 13) * 0x1p112f;
        return (NativeFloat)((NativeInt)size | (i & 0x8000) << 16);
#endif
    });
}
#endif

// The first `count` <= 16, followed by zeros.
SPLAT_INLINE Float load_first_as_float(const scalar* p, int count) { return Float::load_first(p, count); }
template <class Half>
SPLAT_INLINE Float load_first_as_float(const Half* p, int count) {
    Half lane[kLanes] = {};
    for (int i = 0; i < count; ++i) lane[i] = p[i];
    return load_as_float(lane);
}

}  // namespace splat
