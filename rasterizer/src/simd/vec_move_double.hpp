// The data movement of vec_move.hpp for doubles, four at a time.
#pragma once

#include <cstddef>

namespace splat {

SPLAT_INLINE Quad load_quad(const double* p) {
    Quad q;
    std::memcpy(&q, p, sizeof q);
    return q;
}
SPLAT_INLINE void store_quad(double* p, Quad q) { std::memcpy(p, &q, sizeof q); }

// The rows of a 4×4 matrix become its columns.
SPLAT_INLINE void transpose_quads(Quad (&m)[4]) {
    const Quad a = __builtin_shufflevector(m[0], m[1], 0, 4, 2, 6),
               b = __builtin_shufflevector(m[0], m[1], 1, 5, 3, 7),
               c = __builtin_shufflevector(m[2], m[3], 0, 4, 2, 6),
               d = __builtin_shufflevector(m[2], m[3], 1, 5, 3, 7);
    m[0] = __builtin_shufflevector(a, c, 0, 1, 4, 5), m[1] = __builtin_shufflevector(b, d, 0, 1, 4, 5);
    m[2] = __builtin_shufflevector(a, c, 2, 3, 6, 7), m[3] = __builtin_shufflevector(b, d, 2, 3, 6, 7);
}

// Lane f of the result is the sum over the lanes of v[f]. 4 · groups sums, followed by zeros.
template <int groups>
SPLAT_INLINE Float sum_lanes(const NativeFloat (&v)[4 * groups]) {
    alignas(64) double sum[kLanes] = {};
    for (int f = 0; f < 4 * groups; ++f)
        for (int l = 0; l < kNativeLanes; ++l) sum[f] += v[f][l];
    return Float::load(sum);
}

// Quad j of m[i] becomes quad i of m[j].
SPLAT_INLINE void transpose_of_quads(Float (&m)[4]) {
    alignas(64) double from[4][kLanes], to[4][kLanes];
    for (int i = 0; i < 4; ++i) m[i].store(from[i]);
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) store_quad(&to[j][4 * i], load_quad(&from[i][4 * j]));
    for (int i = 0; i < 4; ++i) m[i] = Float::load(to[i]);
}

// Transposes a 16×16 matrix of sixteen rows in place.
__attribute__((noinline)) inline void transpose(Float (&m)[16]) {
    alignas(64) double from[16][16], to[16][16];
    for (int i = 0; i < 16; ++i) m[i].store(from[i]);
    for (int i = 0; i < 16; i += 4)
        for (int j = 0; j < 16; j += 4) {
            Quad q[4];
            for (int k = 0; k < 4; ++k) q[k] = load_quad(&from[i + k][j]);
            transpose_quads(q);
            for (int k = 0; k < 4; ++k) store_quad(&to[j + k][i], q[k]);
        }
    for (int i = 0; i < 16; ++i) m[i] = Float::load(to[i]);
}

// Rows ids[0..15] of an array of four-double rows, as four columns of sixteen lanes.
SPLAT_INLINE void load_rows4(const double* rows, const uint32_t* ids, Float (&column)[4]) {
    alignas(64) double lane[4][kLanes];
    for (int i = 0; i < kLanes; i += 4) {
        Quad q[4];
        for (int k = 0; k < 4; ++k) q[k] = load_quad(rows + 4 * static_cast<size_t>(ids[i + k]));
        transpose_quads(q);
        for (int k = 0; k < 4; ++k) store_quad(&lane[k][i], q[k]);
    }
    for (int k = 0; k < 4; ++k) column[k] = Float::load(lane[k]);
}

// Adds four columns of lanes to rows ids[0..count-1] of an array of four-double rows. The ids differ.
SPLAT_INLINE void add_to_rows4(double* rows, const uint32_t* ids, int count, const Float (&column)[4]) {
    alignas(64) double lane[4][kLanes];
    for (int k = 0; k < 4; ++k) column[k].store(lane[k]);
    for (int i = 0; i < count; i += 4) {
        Quad q[4];
        for (int k = 0; k < 4; ++k) q[k] = load_quad(&lane[k][i]);
        transpose_quads(q);
        for (int k = 0; k < 4 && i + k < count; ++k) {
            double* row = rows + 4 * static_cast<size_t>(ids[i + k]);
            store_quad(row, load_quad(row) + q[k]);
        }
    }
}

}  // namespace splat
