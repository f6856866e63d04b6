// Operations on one native register of doubles that the compiler's own vectors lack (vec.hpp).
//
// The float64 kernel serves for comparison with the float32 one (`python -m
// pipeline.studies.kernel_precision`): the same loops over the same lanes, with twice as many registers.
#pragma once

namespace splat {

SPLAT_INLINE NativeFloat native_min(NativeFloat a, NativeFloat b) { return a < b ? a : b; }
SPLAT_INLINE NativeFloat native_max(NativeFloat a, NativeFloat b) { return a > b ? a : b; }

SPLAT_INLINE NativeFloat native_sqrt(NativeFloat a) {
    for (int i = 0; i < kNativeLanes; ++i) a[i] = __builtin_sqrt(a[i]);
    return a;
}

// A comparison's result as bits, one per lane.
SPLAT_INLINE unsigned native_bits(NativeInt m) {
#if defined(__AVX512DQ__)
    return _mm512_movepi64_mask((__m512i)m);
#elif defined(__AVX2__)
    return static_cast<unsigned>(_mm256_movemask_pd((__m256d)m));
#elif defined(__SSE2__)
    return static_cast<unsigned>(_mm_movemask_pd((__m128d)m));
#else
    return (m[0] & 1u) | (m[1] & 2u);
#endif
}

// The words at p, each in the lower half of a lane; the upper half is zero.
SPLAT_INLINE NativeFloat words_in_lanes(const uint32_t* p) {
    NativeInt r;
    for (int i = 0; i < kNativeLanes; ++i) r[i] = p[i];
    return (NativeFloat)r;
}

SPLAT_INLINE void stream_native(double* p, NativeFloat a) {
#if defined(__AVX512DQ__)
    _mm512_stream_pd(p, (__m512d)a);
#elif defined(__AVX2__)
    _mm256_stream_pd(p, (__m256d)a);
#elif defined(__SSE2__)
    _mm_stream_pd(p, (__m128d)a);
#else
    std::memcpy(p, &a, sizeof a);
#endif
}

}  // namespace splat
