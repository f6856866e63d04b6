// Sixteen lanes summed, transposed, gathered from rows and packed: how data gets in and out of a Float.
#pragma once

#include "vec.hpp"

namespace splat {

// ---- horizontal sums

// Four sums over the lanes of a, b, c and d: one quad.
SPLAT_INLINE Quad sum_lanes(const Float& a, const Float& b, const Float& c, const Float& d) {
    auto fold_parts = [](const Float& v) {
        NativeFloat s = v.part[0];
        for (int i = 1; i < kParts; ++i) s += v.part[i];
        return s;
    };
    NativeFloat na = fold_parts(a), nb = fold_parts(b), nc = fold_parts(c), nd = fold_parts(d);
    NativeFloat ab = unpack_low(na, nb) + unpack_high(na, nb);
    NativeFloat cd = unpack_low(nc, nd) + unpack_high(nc, nd);
    return fold_to_quad(unpack_low_pairs(ab, cd) + unpack_high_pairs(ab, cd));
}

// ---- moving rows to lanes

SPLAT_INLINE void transpose4(Quad (&q)[4]) {
    Quad a = __builtin_shufflevector(q[0], q[1], 0, 4, 1, 5),
         b = __builtin_shufflevector(q[0], q[1], 2, 6, 3, 7);
    Quad c = __builtin_shufflevector(q[2], q[3], 0, 4, 1, 5),
         d = __builtin_shufflevector(q[2], q[3], 2, 6, 3, 7);
    q[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5), q[1] = __builtin_shufflevector(a, c, 2, 3, 6, 7);
    q[2] = __builtin_shufflevector(b, d, 0, 1, 4, 5), q[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

// Transposes a 16×16 matrix of sixteen rows in place.
#if SPLAT_AVX512
SPLAT_INLINE void transpose(Float (&m)[16]) {
    NativeFloat t[16], u[16];
    for (int i = 0; i < 16; i += 4) {  // 4×4 transposes inside each 128-bit lane
        NativeFloat a = unpack_low(m[i].part[0], m[i + 1].part[0]),
                    b = unpack_high(m[i].part[0], m[i + 1].part[0]);
        NativeFloat c = unpack_low(m[i + 2].part[0], m[i + 3].part[0]),
                    d = unpack_high(m[i + 2].part[0], m[i + 3].part[0]);
        t[i] = unpack_low_pairs(a, c), t[i + 1] = unpack_high_pairs(a, c);
        t[i + 2] = unpack_low_pairs(b, d), t[i + 3] = unpack_high_pairs(b, d);
    }
    auto even = [](NativeFloat a, NativeFloat b) {
        return (NativeFloat)_mm512_shuffle_f32x4((__m512)a, (__m512)b, 0x88);
    };
    auto odd = [](NativeFloat a, NativeFloat b) {
        return (NativeFloat)_mm512_shuffle_f32x4((__m512)a, (__m512)b, 0xdd);
    };
    for (int j = 0; j < 4; ++j) {  // then the 4×4 matrix of lanes
        u[j] = even(t[j], t[4 + j]), u[4 + j] = odd(t[j], t[4 + j]);
        u[8 + j] = even(t[8 + j], t[12 + j]), u[12 + j] = odd(t[8 + j], t[12 + j]);
    }
    for (int j = 0; j < 4; ++j) {
        m[j].part[0] = even(u[j], u[8 + j]), m[8 + j].part[0] = odd(u[j], u[8 + j]);
        m[4 + j].part[0] = even(u[4 + j], u[12 + j]), m[12 + j].part[0] = odd(u[4 + j], u[12 + j]);
    }
}
#else
// Through memory, and so not worth inlining: it is called a dozen times in each of a dozen instantiations.
__attribute__((noinline)) inline void transpose(Float (&m)[16]) {
    alignas(64) float from[16][16], to[16][16];
    std::memcpy(from, m, sizeof from);
    for (int i = 0; i < 16; i += 4)
        for (int j = 0; j < 16; j += 4) {
            Quad q[4];
            for (int k = 0; k < 4; ++k) std::memcpy(&q[k], &from[i + k][j], 16);
            transpose4(q);
            for (int k = 0; k < 4; ++k) std::memcpy(&to[j + k][i], &q[k], 16);
        }
    std::memcpy(m, to, sizeof to);
}
#endif

// Rows ids[0..15] of an array of four-float rows, as four columns of sixteen lanes.
SPLAT_INLINE void load_rows4(const float* rows, const uint32_t* ids, Float (&column)[4]) {
    alignas(64) float to[4][16];
    for (int i = 0; i < 16; i += 4) {
        Quad q[4];
        for (int k = 0; k < 4; ++k) std::memcpy(&q[k], rows + 4 * static_cast<size_t>(ids[i + k]), 16);
        transpose4(q);
        for (int k = 0; k < 4; ++k) std::memcpy(&to[k][i], &q[k], 16);
    }
    for (int k = 0; k < 4; ++k) column[k] = Float::load(to[k]);
}

// Adds four columns of lanes to rows ids[0..count-1] of an array of four-float rows. The ids differ.
SPLAT_INLINE void add_to_rows4(float* rows, const uint32_t* ids, int count, const Float (&column)[4]) {
    alignas(64) float from[4][16];
    for (int k = 0; k < 4; ++k) column[k].store(from[k]);
    for (int i = 0; i < count; i += 4) {
        Quad q[4];
        for (int k = 0; k < 4; ++k) std::memcpy(&q[k], &from[k][i], 16);
        transpose4(q);
        for (int k = 0; k < 4 && i + k < count; ++k) {
            float* row = rows + 4 * static_cast<size_t>(ids[i + k]);
            Quad sum;
            std::memcpy(&sum, row, 16);
            sum += q[k];
            std::memcpy(row, &sum, 16);
        }
    }
}

// Writes the lanes whose bit is set in `keep` to p, packed; up to 16 floats from p on may be overwritten.
SPLAT_INLINE void store_packed(float* p, unsigned keep, const Float& a) {
#if SPLAT_AVX512
    _mm512_storeu_ps(p, _mm512_maskz_compress_ps(static_cast<__mmask16>(keep), (__m512)a.part[0]));
#else
    if (keep == 0xffff) return a.store(p);
    alignas(64) float lane[16];
    a.store(lane);
    for (; keep; keep &= keep - 1) *p++ = lane[__builtin_ctz(keep)];
#endif
}

// Copies the items whose mask has `bit` set to `out`, packed (up to 15 more may be overwritten); returns how
// many.
SPLAT_INLINE int pack_matching(const uint32_t* items, const uint16_t* masks, int count, int bit,
                               uint32_t* out) {
    int n = 0;
#if SPLAT_AVX512
    const __m256i wanted = _mm256_set1_epi16(static_cast<short>(1u << bit));
    for (int j = 0; j < count; j += 16) {
        unsigned hit = _mm256_test_epi16_mask(_mm256_loadu_si256((const __m256i*)(masks + j)), wanted);
        if (j + 16 > count) hit &= (1u << (count - j)) - 1;
        _mm512_storeu_si512(
            out + n, _mm512_maskz_compress_epi32(static_cast<__mmask16>(hit), _mm512_loadu_si512(items + j)));
        n += __builtin_popcount(hit);
    }
#else
    for (int j = 0; j < count; ++j) {
        out[n] = items[j];
        n += (masks[j] >> bit) & 1;
    }
#endif
    return n;
}

}  // namespace splat
