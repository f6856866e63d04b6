// Moves data in and out of Floats: horizontal sums, transposes, gathers of rows, permutations, compression.
#pragma once

#include <utility>

#include "simd/vec.hpp"

#if RASTERIZER_FLOAT64
#include "simd/vec_move_double.hpp"
#else
namespace splat {

// ---- horizontal sums

// Lane f of the result is the sum over the lanes of v[f]. 4 · groups sums, followed by zeros.
template <int groups>
SPLAT_INLINE Float sum_lanes(const NativeFloat (&v)[4 * groups]) {
    NativeFloat group[4] = {};  // in each quad part of four sums
    for (int g = 0; g < groups; ++g) {
        const NativeFloat &a = v[4 * g], &b = v[4 * g + 1], &c = v[4 * g + 2], &d = v[4 * g + 3];
        const NativeFloat ab = unpack_low(a, b) + unpack_high(a, b),
                          cd = unpack_low(c, d) + unpack_high(c, d);
        group[g] = unpack_low_pairs(ab, cd) + unpack_high_pairs(ab, cd);
    }
    Float r;
#if SPLAT_AVX512
    const NativeFloat first = even_quads(group[0], group[1]) + odd_quads(group[0], group[1]);
    const NativeFloat second = even_quads(group[2], group[3]) + odd_quads(group[2], group[3]);
    r.part[0] = even_quads(first, second) + odd_quads(first, second);
#elif SPLAT_AVX2
    for (int i = 0; i < kParts; ++i)
        r.part[i] = even_quads(group[2 * i], group[2 * i + 1]) + odd_quads(group[2 * i], group[2 * i + 1]);
#else
    for (int i = 0; i < kParts; ++i) r.part[i] = group[i];
#endif
    return r;
}

// ---- moving rows to lanes

inline constexpr int kQuads = kNativeLanes / 4;  // in a native register

// Rows of four floats, one for each quad.
template <class T>
struct QuadRows {
    T* row[kQuads];
    QuadRows() = default;
    // Quad q is row ids[4 q].
    SPLAT_INLINE QuadRows(T* rows, const uint32_t* ids) {
        for (int q = 0; q < kQuads; ++q) row[q] = rows + 4 * static_cast<size_t>(ids[4 * q]);
    }
};
template <class T>
SPLAT_INLINE NativeFloat load_quads(const QuadRows<T>& from) {
#if SPLAT_AVX512
    __m512 r = _mm512_castps128_ps512(_mm_loadu_ps(from.row[0]));
    r = _mm512_insertf32x4(r, _mm_loadu_ps(from.row[1]), 1);
    r = _mm512_insertf32x4(r, _mm_loadu_ps(from.row[2]), 2);
    return (NativeFloat)_mm512_insertf32x4(r, _mm_loadu_ps(from.row[3]), 3);
#elif SPLAT_AVX2
    const __m256 r = _mm256_castps128_ps256(_mm_loadu_ps(from.row[0]));
    return (NativeFloat)_mm256_insertf128_ps(r, _mm_loadu_ps(from.row[1]), 1);
#else
    NativeFloat r;
    std::memcpy(&r, from.row[0], sizeof r);
    return r;
#endif
}
SPLAT_INLINE void store_quads(const QuadRows<float>& to, NativeFloat a) {
#if SPLAT_AVX512
    _mm_storeu_ps(to.row[0], _mm512_castps512_ps128((__m512)a));
    _mm_storeu_ps(to.row[1], _mm512_extractf32x4_ps((__m512)a, 1));
    _mm_storeu_ps(to.row[2], _mm512_extractf32x4_ps((__m512)a, 2));
    _mm_storeu_ps(to.row[3], _mm512_extractf32x4_ps((__m512)a, 3));
#elif SPLAT_AVX2
    _mm_storeu_ps(to.row[0], _mm256_castps256_ps128((__m256)a));
    _mm_storeu_ps(to.row[1], _mm256_extractf128_ps((__m256)a, 1));
#else
    std::memcpy(to.row[0], &a, sizeof a);
#endif
}

// Each quad of m[0..3] is a row of a 4×4 matrix; afterwards a column of it.
SPLAT_INLINE void transpose_quads(NativeFloat (&m)[4]) {
    const NativeFloat a = unpack_low(m[0], m[1]), b = unpack_high(m[0], m[1]);
    const NativeFloat c = unpack_low(m[2], m[3]), d = unpack_high(m[2], m[3]);
    m[0] = unpack_low_pairs(a, c), m[1] = unpack_high_pairs(a, c);
    m[2] = unpack_low_pairs(b, d), m[3] = unpack_high_pairs(b, d);
}

// Quad j of m[i] becomes quad i of m[j].
SPLAT_INLINE void transpose_of_quads(Float (&m)[4]) {
#if SPLAT_AVX512
    const NativeFloat even01 = even_quads(m[0].part[0], m[1].part[0]),
                      even23 = even_quads(m[2].part[0], m[3].part[0]);
    const NativeFloat odd01 = odd_quads(m[0].part[0], m[1].part[0]),
                      odd23 = odd_quads(m[2].part[0], m[3].part[0]);
    m[0].part[0] = even_quads(even01, even23), m[1].part[0] = even_quads(odd01, odd23);
    m[2].part[0] = odd_quads(even01, even23), m[3].part[0] = odd_quads(odd01, odd23);
#elif SPLAT_AVX2
    Float to[4];
    for (int j = 0; j < 4; ++j)
        for (int i = 0; i < kParts; ++i) {
            const NativeFloat first = m[2 * i].part[j / 2], second = m[2 * i + 1].part[j / 2];
            to[j].part[i] = j % 2 ? odd_quads(first, second) : even_quads(first, second);
        }
    for (int j = 0; j < 4; ++j) m[j] = to[j];
#else
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < i; ++j) std::swap(m[i].part[j], m[j].part[i]);
#endif
}

// Transposes a 16×16 matrix of sixteen rows in place.
#if SPLAT_AVX512
SPLAT_INLINE void transpose(Float (&m)[16]) {
    NativeFloat t[4][4];
    for (int i = 0; i < 4; ++i) {
        for (int j = 0; j < 4; ++j) t[i][j] = m[4 * i + j].part[0];
        transpose_quads(t[i]);
    }
    for (int j = 0; j < 4; ++j) {  // then the 4×4 matrix of quads
        Float column[4];
        for (int i = 0; i < 4; ++i) column[i].part[0] = t[i][j];
        transpose_of_quads(column);
        for (int i = 0; i < 4; ++i) m[4 * i + j] = column[i];
    }
}
#else
// A square of it, as wide as a register.
SPLAT_INLINE void transpose_square(NativeFloat (&row)[kNativeLanes]) {
#if SPLAT_AVX2
    NativeFloat even[4], odd[4];
    for (int k = 0; k < 4; ++k)
        even[k] = even_quads(row[k], row[k + 4]), odd[k] = odd_quads(row[k], row[k + 4]);
    transpose_quads(even);
    transpose_quads(odd);
    for (int k = 0; k < 4; ++k) row[k] = even[k], row[k + 4] = odd[k];
#else
    transpose_quads(row);
#endif
}
// Not inlined: a dozen instantiations call it a dozen times each.
__attribute__((noinline)) inline void transpose(Float (&m)[16]) {
    constexpr int n = kNativeLanes;
    for (int i = 0; i < kParts; ++i)
        for (int j = 0; j <= i; ++j) {  // two squares change places
            NativeFloat a[n], b[n];
            for (int k = 0; k < n; ++k) a[k] = m[n * i + k].part[j], b[k] = m[n * j + k].part[i];
            transpose_square(a);
            if (i != j) transpose_square(b);
            for (int k = 0; k < n; ++k) m[n * j + k].part[i] = a[k];
            if (i != j)
                for (int k = 0; k < n; ++k) m[n * i + k].part[j] = b[k];
        }
}
#endif

// Rows ids[0..15] of an array of four-float rows, as four columns of sixteen lanes.
SPLAT_INLINE void load_rows4(const float* rows, const uint32_t* ids, Float (&column)[4]) {
    for (int i = 0; i < kParts; ++i) {
        NativeFloat m[4];
        for (int k = 0; k < 4; ++k)
            m[k] = load_quads(QuadRows<const float>(rows, ids + kNativeLanes * i + k));
        transpose_quads(m);
        for (int k = 0; k < 4; ++k) column[k].part[i] = m[k];
    }
}

// Adds four columns of lanes to rows ids[0..count-1] of an array of four-float rows. The ids differ.
SPLAT_INLINE void add_to_rows4(float* rows, const uint32_t* ids, int count, const Float (&column)[4]) {
    if (count < kLanes) {
        alignas(64) float lane[4][kLanes];
        for (int k = 0; k < 4; ++k) column[k].store(lane[k]);
        for (int l = 0; l < count; ++l)
            for (int k = 0; k < 4; ++k) rows[4 * static_cast<size_t>(ids[l]) + k] += lane[k][l];
        return;
    }
    for (int i = 0; i < kParts; ++i) {
        NativeFloat m[4];
        for (int k = 0; k < 4; ++k) m[k] = column[k].part[i];
        transpose_quads(m);
        for (int k = 0; k < 4; ++k) {
            const QuadRows<float> to(rows, ids + kNativeLanes * i + k);
            store_quads(to, load_quads(to) + m[k]);
        }
    }
}

}  // namespace splat
#endif

namespace splat {

// Lane l of the result is lane index[l] of a. The eight indices of each half must be in one half of a, so
// that AVX2 too needs one instruction only.
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
    alignas(64) scalar from[kLanes], to[kLanes];
    a.store(from);
    for (int l = 0; l < kLanes; ++l) to[l] = from[index[l]];
    r = Float::load(to);
#endif
    return r;
}

#if defined(SPLAT_AVX2)  // words too, whatever a lane is
// Row m: the positions of the bits set in m, then zeros.
inline constexpr struct BitPositions {
    alignas(64) uint8_t of[256][8];
    constexpr BitPositions() : of{} {
        for (int m = 0; m < 256; ++m)
            for (int bit = 0, n = 0; bit < 8; ++bit)
                if (m >> bit & 1) of[m][n++] = static_cast<uint8_t>(bit);
    }
} kBitPositions;

// Writes the words whose bit is set in `keep` to `out`, contiguously; returns how many. Overwrites eight.
SPLAT_INLINE int compress_eight(__m256i words, unsigned keep, void* out) {
    const __m256i from = _mm256_cvtepu8_epi32(_mm_loadl_epi64((const __m128i*)kBitPositions.of[keep]));
    _mm256_storeu_si256((__m256i*)out, _mm256_permutevar8x32_epi32(words, from));
    return __builtin_popcount(keep);
}
#endif

// Writes the lanes whose bit is set in `keep` to p, contiguously. Up to 16 floats from p on may be
// overwritten.
SPLAT_INLINE void compress_store(scalar* p, unsigned keep, const Float& a) {
#if SPLAT_AVX512
    _mm512_storeu_ps(p, _mm512_maskz_compress_ps(static_cast<__mmask16>(keep), (__m512)a.part[0]));
#elif SPLAT_AVX2
    p += compress_eight((__m256i)a.part[0], keep & 0xff, p);
    compress_eight((__m256i)a.part[1], keep >> 8, p);
#else
    if (keep == 0xffff) return a.store(p);
    alignas(64) scalar lane[16];
    a.store(lane);
    for (; keep; keep &= keep - 1) *p++ = lane[__builtin_ctz(keep)];
#endif
}

// Copies items[l] for each set bit l of `keep` to `out`, contiguously; returns how many. Up to 16 words from
// `out` on may be overwritten.
SPLAT_INLINE int compress_store_words(const uint32_t* items, unsigned keep, uint32_t* out) {
#if defined(SPLAT_AVX512)  // these are words, whatever a lane is
    _mm512_storeu_si512(out,
                        _mm512_maskz_compress_epi32(static_cast<__mmask16>(keep), _mm512_loadu_si512(items)));
#elif defined(SPLAT_AVX2)
    out += compress_eight(_mm256_loadu_si256((const __m256i*)items), keep & 0xff, out);
    compress_eight(_mm256_loadu_si256((const __m256i*)(items + 8)), keep >> 8, out);
#else
    for (unsigned left = keep; left; left &= left - 1) *out++ = items[__builtin_ctz(left)];
#endif
    return __builtin_popcount(keep);
}

// Copies the items whose mask has `bit` set to `out`, contiguously; returns how many. Up to 15 words more may
// be overwritten.
SPLAT_INLINE int compress_matching(const uint32_t* items, const uint16_t* masks, int count, int bit,
                                   uint32_t* out) {
    int n = 0;
#if defined(SPLAT_AVX512)  // these are words, whatever a lane is
    const __m256i wanted = _mm256_set1_epi16(static_cast<short>(1u << bit));
    for (int j = 0; j < count; j += 16) {
        unsigned hit = _mm256_test_epi16_mask(_mm256_loadu_si256((const __m256i*)(masks + j)), wanted);
        if (j + 16 > count) hit &= (1u << (count - j)) - 1;
        _mm512_storeu_si512(
            out + n, _mm512_maskz_compress_epi32(static_cast<__mmask16>(hit), _mm512_loadu_si512(items + j)));
        n += __builtin_popcount(hit);
    }
#elif defined(SPLAT_AVX2)
    const __m128i wanted = _mm_set1_epi16(static_cast<short>(1u << bit));
    for (int j = 0; j < count; j += 8) {
        const __m128i touched = _mm_and_si128(_mm_loadu_si128((const __m128i*)(masks + j)), wanted);
        unsigned hit = _mm_movemask_epi8(_mm_packs_epi16(_mm_cmpeq_epi16(touched, wanted), __m128i{}));
        if (j + 8 > count) hit &= (1u << (count - j)) - 1;
        n += compress_eight(_mm256_loadu_si256((const __m256i*)(items + j)), hit, out + n);
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
