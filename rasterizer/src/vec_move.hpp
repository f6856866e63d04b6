// Sixteen lanes summed, transposed, gathered from rows and packed: how data gets in and out of a Float.
#pragma once

#include "vec.hpp"

namespace splat {

// ---- horizontal sums

// Lane f of the result is the sum over the lanes of v[f]; 4 · groups sums, zeros behind them.
template <int groups>
SPLAT_INLINE Float sum_lanes(const Float (&v)[4 * groups]) {
    auto fold_parts = [](const Float& a) {
        NativeFloat s = a.part[0];
        for (int i = 1; i < kParts; ++i) s += a.part[i];
        return s;
    };
    NativeFloat group[4] = {};  // in each 128-bit lane part of four sums
    for (int g = 0; g < groups; ++g) {
        const NativeFloat a = fold_parts(v[4 * g]), b = fold_parts(v[4 * g + 1]),
                          c = fold_parts(v[4 * g + 2]), d = fold_parts(v[4 * g + 3]);
        const NativeFloat ab = unpack_low(a, b) + unpack_high(a, b),
                          cd = unpack_low(c, d) + unpack_high(c, d);
        group[g] = unpack_low_pairs(ab, cd) + unpack_high_pairs(ab, cd);
    }
    Float r;
#if SPLAT_AVX512
    const NativeFloat first = even_quads(group[0], group[1]) + odd_quads(group[0], group[1]);
    const NativeFloat second = even_quads(group[2], group[3]) + odd_quads(group[2], group[3]);
    r.part[0] = even_quads(first, second) + odd_quads(first, second);
#else
    alignas(64) Quad quad[4];
    for (int g = 0; g < 4; ++g) quad[g] = fold_to_quad(group[g]);
    std::memcpy(&r, quad, sizeof r);
#endif
    return r;
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
    for (int j = 0; j < 4; ++j) {  // then the 4×4 matrix of lanes
        u[j] = even_quads(t[j], t[4 + j]), u[4 + j] = odd_quads(t[j], t[4 + j]);
        u[8 + j] = even_quads(t[8 + j], t[12 + j]), u[12 + j] = odd_quads(t[8 + j], t[12 + j]);
    }
    for (int j = 0; j < 4; ++j) {
        m[j].part[0] = even_quads(u[j], u[8 + j]), m[8 + j].part[0] = odd_quads(u[j], u[8 + j]);
        m[4 + j].part[0] = even_quads(u[4 + j], u[12 + j]),
              m[12 + j].part[0] = odd_quads(u[4 + j], u[12 + j]);
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

// Lane l of the result is lane index[l] of a. The eight indices of each half must lie in one half of a: then
// one instruction does it on AVX2 too.
SPLAT_INLINE Float permute(const Float& a, const int32_t (&index)[kLanes]) {
    Float r;
#if SPLAT_AVX512
    r.part[0] = (NativeFloat)_mm512_permutexvar_ps(_mm512_load_si512(index), (__m512)a.part[0]);
#elif SPLAT_AVX2
    for (int i = 0; i < kParts; ++i) {
        const __m256i at =
            _mm256_load_si256((const __m256i*)&index[kNativeLanes * i]);  // its low three bits count
        const __m256 from = (__m256)a.part[index[kNativeLanes * i] / kNativeLanes];
        r.part[i] = (NativeFloat)_mm256_permutevar8x32_ps(from, at);
    }
#else
    alignas(64) float from[kLanes], to[kLanes];
    a.store(from);
    for (int l = 0; l < kLanes; ++l) to[l] = from[index[l]];
    r = Float::load(to);
#endif
    return r;
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
