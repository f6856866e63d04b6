// Operations on one native register of floats (vec.hpp).
#pragma once

namespace splat {

#if SPLAT_AVX512
SPLAT_INLINE NativeFloat native_min(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_min_ps((__m512)a, (__m512)b);
}
SPLAT_INLINE NativeFloat native_max(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_max_ps((__m512)a, (__m512)b);
}
SPLAT_INLINE NativeFloat native_sqrt(NativeFloat a) { return (NativeFloat)_mm512_sqrt_ps((__m512)a); }
SPLAT_INLINE NativeFloat unpack_low(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_unpacklo_ps((__m512)a, (__m512)b);
}
SPLAT_INLINE NativeFloat unpack_high(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_unpackhi_ps((__m512)a, (__m512)b);
}
SPLAT_INLINE NativeFloat unpack_low_pairs(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_unpacklo_pd((__m512d)a, (__m512d)b);
}
SPLAT_INLINE NativeFloat unpack_high_pairs(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_unpackhi_pd((__m512d)a, (__m512d)b);
}
// Quads 0 and 2 of a, then of b; 1 and 3 of a, then of b.
SPLAT_INLINE NativeFloat even_quads(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_shuffle_f32x4((__m512)a, (__m512)b, 0x88);
}
SPLAT_INLINE NativeFloat odd_quads(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm512_shuffle_f32x4((__m512)a, (__m512)b, 0xdd);
}
#elif SPLAT_AVX2
SPLAT_INLINE NativeFloat native_min(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_min_ps((__m256)a, (__m256)b);
}
SPLAT_INLINE NativeFloat native_max(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_max_ps((__m256)a, (__m256)b);
}
SPLAT_INLINE NativeFloat native_sqrt(NativeFloat a) { return (NativeFloat)_mm256_sqrt_ps((__m256)a); }
SPLAT_INLINE NativeFloat unpack_low(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_unpacklo_ps((__m256)a, (__m256)b);
}
SPLAT_INLINE NativeFloat unpack_high(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_unpackhi_ps((__m256)a, (__m256)b);
}
SPLAT_INLINE NativeFloat unpack_low_pairs(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_unpacklo_pd((__m256d)a, (__m256d)b);
}
SPLAT_INLINE NativeFloat unpack_high_pairs(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_unpackhi_pd((__m256d)a, (__m256d)b);
}
// The first quad of a, then of b; the second of a, then of b.
SPLAT_INLINE NativeFloat even_quads(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_permute2f128_ps((__m256)a, (__m256)b, 0x20);
}
SPLAT_INLINE NativeFloat odd_quads(NativeFloat a, NativeFloat b) {
    return (NativeFloat)_mm256_permute2f128_ps((__m256)a, (__m256)b, 0x31);
}
#else
SPLAT_INLINE NativeFloat native_min(NativeFloat a, NativeFloat b) { return a < b ? a : b; }
SPLAT_INLINE NativeFloat native_max(NativeFloat a, NativeFloat b) { return a > b ? a : b; }
#if SPLAT_SSE2
SPLAT_INLINE NativeFloat native_sqrt(NativeFloat a) { return (NativeFloat)_mm_sqrt_ps((__m128)a); }
#else
SPLAT_INLINE NativeFloat native_sqrt(NativeFloat a) {
    for (int i = 0; i < 4; ++i) a[i] = __builtin_sqrtf(a[i]);
    return a;
}
#endif
SPLAT_INLINE NativeFloat unpack_low(NativeFloat a, NativeFloat b) {
    return __builtin_shufflevector(a, b, 0, 4, 1, 5);
}
SPLAT_INLINE NativeFloat unpack_high(NativeFloat a, NativeFloat b) {
    return __builtin_shufflevector(a, b, 2, 6, 3, 7);
}
SPLAT_INLINE NativeFloat unpack_low_pairs(NativeFloat a, NativeFloat b) {
    return __builtin_shufflevector(a, b, 0, 1, 4, 5);
}
SPLAT_INLINE NativeFloat unpack_high_pairs(NativeFloat a, NativeFloat b) {
    return __builtin_shufflevector(a, b, 2, 3, 6, 7);
}
#endif

#if !SPLAT_AVX512  // with AVX-512 comparisons give bits
// A comparison's result as bits, one per lane.
SPLAT_INLINE unsigned native_bits(NativeInt m) {
#if SPLAT_AVX2
    return static_cast<unsigned>(_mm256_movemask_ps((__m256)m));
#elif SPLAT_SSE2
    return static_cast<unsigned>(_mm_movemask_ps((__m128)m));
#else
    return (m[0] & 1u) | (m[1] & 2u) | (m[2] & 4u) | (m[3] & 8u);
#endif
}
#endif

// The words at p, bit by bit, one per lane.
SPLAT_INLINE NativeFloat words_in_lanes(const uint32_t* p) {
    NativeFloat r;
    std::memcpy(&r, p, sizeof r);
    return r;
}

}  // namespace splat
