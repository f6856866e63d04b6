// Float: a vector of sixteen floats. Only simd/ knows the processor's vector instructions.
//
// A lane is one Gaussian (preprocess) or one pixel of a 4×4 block (blend). A Float consists of as many native
// registers as the instruction set needs: one with AVX-512, two with AVX2, four otherwise. Native registers,
// because GCC turns generic 64-byte vectors into scalar code where AVX-512 is missing.
//
// With RASTERIZER_FLOAT64 a Float is sixteen doubles, in code that depends only on a register's width.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>
#if defined(__x86_64__)
#include <immintrin.h>
#endif

#include "numerical_choices.hpp"

namespace splat {

#if defined(__AVX512F__) && defined(__AVX512BW__) && defined(__AVX512DQ__) && defined(__AVX512VL__)
#define SPLAT_AVX512 !RASTERIZER_FLOAT64
inline constexpr int kNativeBytes = 64;
#elif defined(__AVX2__)
#define SPLAT_AVX2 !RASTERIZER_FLOAT64
inline constexpr int kNativeBytes = 32;
#else
inline constexpr int kNativeBytes = 16;
#endif
#if defined(__SSE2__)
#define SPLAT_SSE2 !RASTERIZER_FLOAT64
#endif

inline constexpr int kLanes = 16;
inline constexpr int kNativeLanes = kNativeBytes / sizeof(scalar);
inline constexpr int kParts = kLanes / kNativeLanes;

#define SPLAT_INLINE inline __attribute__((always_inline))

using Word = std::conditional_t<sizeof(scalar) == 4, int32_t, int64_t>;  // as wide as a lane
using NativeFloat = scalar __attribute__((vector_size(kNativeBytes)));
using NativeInt = Word __attribute__((vector_size(kNativeBytes)));
using Quad = scalar __attribute__((vector_size(4 * sizeof(scalar))));  // a row of a mean, scale or quaternion

}  // namespace splat

#if RASTERIZER_FLOAT64
#include "simd/vec_double.hpp"
#else
#include "simd/vec_float.hpp"
#endif

namespace splat {

struct Float {
    NativeFloat part[kParts];
    Float() = default;
    // Per register: GCC copies a struct of several through memory, in pieces that the next load waits for.
    SPLAT_INLINE Float(const Float& a) {
        for (int i = 0; i < kParts; ++i) part[i] = a.part[i];
    }
    SPLAT_INLINE Float& operator=(const Float& a) {
        for (int i = 0; i < kParts; ++i) part[i] = a.part[i];
        return *this;
    }
    SPLAT_INLINE Float(scalar x) {
        for (auto& p : part) p = x - NativeFloat{};  // x - 0 is x for every x, so this is a plain broadcast
    }
    SPLAT_INLINE static Float load(const scalar* p) {
        Float r;
        for (int i = 0; i < kParts; ++i) std::memcpy(&r.part[i], p + i * kNativeLanes, sizeof r.part[i]);
        return r;
    }
    // Sixteen words, bit by bit, each at the beginning of its lane; to be moved, not computed with.
    SPLAT_INLINE static Float load_bits(const uint32_t* p) {
        Float r;
        for (int i = 0; i < kParts; ++i) r.part[i] = words_in_lanes(p + i * kNativeLanes);
        return r;
    }
    SPLAT_INLINE void store(scalar* p) const {
        for (int i = 0; i < kParts; ++i) std::memcpy(p + i * kNativeLanes, &part[i], sizeof part[i]);
    }
    // Non-temporal store to 64-byte aligned p, past the caches: for results that are not read soon. Call
    // `end_of_streaming` before they are.
    SPLAT_INLINE void stream(scalar* p) const {
#if SPLAT_AVX512
        _mm512_stream_ps(p, (__m512)part[0]);
#elif SPLAT_AVX2
        for (int i = 0; i < kParts; ++i) _mm256_stream_ps(p + i * kNativeLanes, (__m256)part[i]);
#elif SPLAT_SSE2
        for (int i = 0; i < kParts; ++i) _mm_stream_ps(p + i * kNativeLanes, (__m128)part[i]);
#elif RASTERIZER_FLOAT64
        for (int i = 0; i < kParts; ++i) stream_native(p + i * kNativeLanes, part[i]);
#else
        store(p);
#endif
    }
    // The first `count` <= 16 floats at p, followed by zeros.
    SPLAT_INLINE static Float load_first(const scalar* p, int count) {
#if SPLAT_AVX512
        Float r;
        r.part[0] = (NativeFloat)_mm512_maskz_loadu_ps(static_cast<__mmask16>((1u << count) - 1), p);
        return r;
#else
        if (count == kLanes) return load(p);
        alignas(64) scalar lane[kLanes] = {};
        for (int i = 0; i < count; ++i) lane[i] = p[i];
        return load(lane);
#endif
    }
    SPLAT_INLINE void store_first(scalar* p, int count) const {
#if SPLAT_AVX512
        _mm512_mask_storeu_ps(p, static_cast<__mmask16>((1u << count) - 1), (__m512)part[0]);
#else
        if (count == kLanes) return store(p);
        alignas(64) scalar lane[kLanes];
        store(lane);
        for (int i = 0; i < count; ++i) p[i] = lane[i];
#endif
    }
};

SPLAT_INLINE void end_of_streaming() {
#if defined(__SSE2__)
    _mm_sfence();
#endif
}

struct Mask {
#if SPLAT_AVX512
    __mmask16 bits;
#else
    NativeInt part[kParts];
    Mask() = default;
    SPLAT_INLINE Mask(const Mask& a) {  // as a Float's
        for (int i = 0; i < kParts; ++i) part[i] = a.part[i];
    }
    SPLAT_INLINE Mask& operator=(const Mask& a) {
        for (int i = 0; i < kParts; ++i) part[i] = a.part[i];
        return *this;
    }
#endif
};

#define SPLAT_ELEMENTWISE(op)                                                \
    SPLAT_INLINE Float operator op(const Float& a, const Float& b) {         \
        Float r;                                                             \
        for (int i = 0; i < kParts; ++i) r.part[i] = a.part[i] op b.part[i]; \
        return r;                                                            \
    }                                                                        \
    SPLAT_INLINE Float& operator op## = (Float & a, const Float& b) { return a = a op b; }
SPLAT_ELEMENTWISE(+)
SPLAT_ELEMENTWISE(-)
SPLAT_ELEMENTWISE(*)
SPLAT_ELEMENTWISE(/)
#undef SPLAT_ELEMENTWISE

SPLAT_INLINE Float operator-(const Float& a) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = -a.part[i];
    return r;
}

// ---- comparisons and masks

#if SPLAT_AVX512
SPLAT_INLINE Mask operator>=(const Float& a, const Float& b) {
    return {_mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_GE_OQ)};
}
SPLAT_INLINE Mask operator>(const Float& a, const Float& b) {
    return {_mm512_cmp_ps_mask((__m512)a.part[0], (__m512)b.part[0], _CMP_GT_OQ)};
}
SPLAT_INLINE Mask operator&(Mask a, Mask b) { return {static_cast<__mmask16>(a.bits & b.bits)}; }
SPLAT_INLINE unsigned bits(Mask m) { return m.bits; }
SPLAT_INLINE Float select(Mask m, const Float& yes, const Float& no) {
    Float r;
    r.part[0] = (NativeFloat)_mm512_mask_blend_ps(m.bits, (__m512)no.part[0], (__m512)yes.part[0]);
    return r;
}
SPLAT_INLINE Float zero_unless(Mask m, const Float& a) {
    Float r;
    r.part[0] = (NativeFloat)_mm512_maskz_mov_ps(m.bits, (__m512)a.part[0]);
    return r;
}
#else
SPLAT_INLINE Mask operator>=(const Float& a, const Float& b) {
    Mask m;
    for (int i = 0; i < kParts; ++i) m.part[i] = a.part[i] >= b.part[i];
    return m;
}
SPLAT_INLINE Mask operator>(const Float& a, const Float& b) {
    Mask m;
    for (int i = 0; i < kParts; ++i) m.part[i] = a.part[i] > b.part[i];
    return m;
}
SPLAT_INLINE Mask operator&(const Mask& a, const Mask& b) {
    Mask r;
    for (int i = 0; i < kParts; ++i) r.part[i] = a.part[i] & b.part[i];
    return r;
}
SPLAT_INLINE unsigned bits(const Mask& m) {
    unsigned r = 0;
    for (int i = 0; i < kParts; ++i) r |= native_bits(m.part[i]) << (i * kNativeLanes);
    return r;
}
SPLAT_INLINE Float select(const Mask& m, const Float& yes, const Float& no) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = m.part[i] ? yes.part[i] : no.part[i];
    return r;
}
SPLAT_INLINE Float zero_unless(const Mask& m, const Float& a) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = (NativeFloat)((NativeInt)a.part[i] & m.part[i]);
    return r;
}
#endif
SPLAT_INLINE Mask operator<=(const Float& a, const Float& b) { return b >= a; }
SPLAT_INLINE Mask operator<(const Float& a, const Float& b) { return b > a; }

SPLAT_INLINE Float min(const Float& a, const Float& b) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = native_min(a.part[i], b.part[i]);
    return r;
}
SPLAT_INLINE Float max(const Float& a, const Float& b) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = native_max(a.part[i], b.part[i]);
    return r;
}
SPLAT_INLINE Float sqrt(const Float& a) {
    Float r;
    for (int i = 0; i < kParts; ++i) r.part[i] = native_sqrt(a.part[i]);
    return r;
}
SPLAT_INLINE Float clamp(const Float& a, const Float& low, const Float& high) {
    return min(max(a, low), high);
}
SPLAT_INLINE Float abs(const Float& a) { return max(a, -a); }

}  // namespace splat
