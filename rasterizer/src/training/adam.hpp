// Adam (Kingma & Ba 2015), fused into one pass, with torch.optim.Adam's arithmetic.
//
//     m ← β1 m + (1-β1) g,  v ← β2 v + (1-β2) g²,  p ← p - lr/(1-β1ᵗ) · m / (√v/√(1-β2ᵗ) + ε)
#pragma once

#include <cmath>

#include "backward/sh_backward.hpp"
#include "simd/denormals.hpp"

namespace splat {

struct AdamStep {
    scalar beta1, beta2, epsilon;
    scalar one_minus_beta1, one_minus_beta2;  // from double: 1.f - 0.999f is off by 1e-5
    scalar inverse_correction1;               // 1/(1-β1ᵗ)
    scalar inverse_sqrt_correction2;          // 1/√(1-β2ᵗ)

    AdamStep(double beta1, double beta2, double epsilon, long step)
        : beta1(static_cast<scalar>(beta1)),
          beta2(static_cast<scalar>(beta2)),
          epsilon(static_cast<scalar>(epsilon)),
          one_minus_beta1(static_cast<scalar>(1 - beta1)),
          one_minus_beta2(static_cast<scalar>(1 - beta2)),
          inverse_correction1(static_cast<scalar>(1 / (1 - std::pow(beta1, step)))),
          inverse_sqrt_correction2(static_cast<scalar>(1 / std::sqrt(1 - std::pow(beta2, step)))) {}
};

SPLAT_INLINE void adam_vector(Float& p, const Float& g, Float& m, Float& v, const Float& rate,
                              const AdamStep& a) {
    m = Float(a.beta1) * m + Float(a.one_minus_beta1) * g;
    v = Float(a.beta2) * v + Float(a.one_minus_beta2) * (g * g);
    p -= rate * m / (sqrt(v) * Float(a.inverse_sqrt_correction2) + Float(a.epsilon));
}

// sparse_rows[row] of each of the n floats from `at` on, followed by zeros.
SPLAT_INLINE Float row_lanes(const uint8_t* sparse_rows, size_t at, int n, int columns) {
    alignas(64) scalar lane[kLanes] = {};
    size_t row = at / columns;
    int column = static_cast<int>(at % columns);
    for (int l = 0; l < n; ++l) {
        lane[l] = sparse_rows[row];
        if (++column == columns) column = 0, ++row;
    }
    return Float::load(lane);
}

// Updates rows of `columns` floats, with one learning rate per column. sparse_rows: one byte per row, 0
// leaves the row and its moments as they are; null updates all.
inline void adam_rows(scalar* p, const scalar* g, scalar* m, scalar* v, size_t rows, int columns,
                      const scalar* lr, const uint8_t* sparse_rows, const AdamStep& a, int threads) {
    // The rows are read as one array. Lane l of its vector k has column (16 k + l) mod columns, so the
    // vectors of learning rates repeat with k mod columns.
    std::vector<Float> rate(columns);
    alignas(64) scalar lane[kLanes];
    for (int k = 0; k < columns; ++k) {
        for (int l = 0; l < kLanes; ++l) lane[l] = lr[(kLanes * k + l) % columns] * a.inverse_correction1;
        rate[k] = Float::load(lane);
    }
    const size_t floats = rows * columns, vectors = (floats + kLanes - 1) / kLanes;
#pragma omp parallel num_threads(threads)
    {
        const FlushDenormals flushed;
#pragma omp for schedule(static)
        for (size_t k = 0; k < vectors; ++k) {
            const size_t at = k * kLanes;
            const int n = static_cast<int>(std::min<size_t>(kLanes, floats - at));
            const bool whole = n == kLanes;
            auto load = [&](const scalar* from) {
                return whole ? Float::load(from + at) : Float::load_first(from + at, n);
            };
            auto store = [&](const Float& value, scalar* to) {
                whole ? value.store(to + at) : value.store_first(to + at, n);
            };
            const Float p0 = load(p), m0 = load(m), v0 = load(v);
            Float pk = p0, mk = m0, vk = v0;
            adam_vector(pk, load(g), mk, vk, rate[k % columns], a);
            if (sparse_rows) {
                const Mask moves = row_lanes(sparse_rows, at, n, columns) > Float(0.f);
                pk = select(moves, pk, p0), mk = select(moves, mk, m0), vk = select(moves, vk, v0);
            }
            store(pk, p), store(mk, m), store(vk, v);
        }
    }
}

inline constexpr uint32_t kRowsAhead = 3;  // Gaussians prefetched

// Learning rates of SH coefficients, by what a coefficient depends on: nothing, view, time, or both.
struct ShLearningRates {
    scalar constant, view, time, view_time;
};

// The learning rates of one Fourier order's coefficients. The first three floats are degree 0.
inline ShRow sh_learning_rate_row(scalar degree0, scalar rest) {
    const Float others(rest);
    ShRow row;
    for (Float& v : row.v) v = others;
    alignas(64) scalar lane[kLanes];
    others.store(lane);
    for (int k = 0; k < 3; ++k) lane[k] = degree0;
    row.v[0] = Float::load(lane);
    return row;
}

// Adam on SH coefficients [N, orders · coefficients, 3], whose gradient is expanded chunk by chunk and never
// stored. Orders from `active_orders` on, and coefficients from `active_coefficients` on, stay as they are:
// they have had no gradient yet, so their moments are zero. sparse_rows: as in adam_rows.
inline void adam_sh(scalar* sh, scalar* m, scalar* v, uint32_t count, int coefficients, int orders,
                    int active_coefficients, int active_orders, const ShLearningRates& lr,
                    const uint8_t* sparse_rows, const std::vector<ViewColors>& views, const AdamStep& a,
                    int threads) {
    const size_t order_stride = static_cast<size_t>(coefficients) * 3, row_stride = order_stride * orders;
    const scalar correction = a.inverse_correction1;
    const ShRow order0 = sh_learning_rate_row(lr.constant * correction, lr.view * correction);
    const ShRow others = sh_learning_rate_row(lr.time * correction, lr.view_time * correction);
#pragma omp parallel num_threads(threads)
    {
        const FlushDenormals flushed;
        ShGradientChunk chunk(active_orders);
#pragma omp for schedule(dynamic, 4)
        for (uint32_t first = 0; first < count; first += kShChunk) {
            const uint32_t last = std::min(count, first + kShChunk);
            expand_sh_gradient(views, first, last, chunk);
            for (uint32_t i = first; i < last; ++i) {
                if (i + kRowsAhead < last && (!sparse_rows || sparse_rows[i + kRowsAhead]))
                    for (int n = 0; n < active_orders; ++n)
                        for (int k = 0; k < 3 * active_coefficients; k += kLanes) {
                            const size_t at = row_stride * (i + kRowsAhead) + order_stride * n + k;
                            // for reading: prefetching for writing takes a tenth longer here
                            __builtin_prefetch(sh + at), __builtin_prefetch(m + at),
                                __builtin_prefetch(v + at);
                        }
                if (sparse_rows && !sparse_rows[i]) continue;
                for (int n = 0; n < active_orders; ++n) {
                    const size_t at = row_stride * i + order_stride * n;
                    const ShRow& g = chunk.rows[static_cast<size_t>(i - first) * active_orders + n];
                    ShRow pr = ShRow::load(sh + at, active_coefficients);
                    ShRow mr = ShRow::load(m + at, active_coefficients),
                          vr = ShRow::load(v + at, active_coefficients);
                    for (int k = 0; k < kRowVectors; ++k)
                        adam_vector(pr.v[k], g.v[k], mr.v[k], vr.v[k], (n == 0 ? order0 : others).v[k], a);
                    pr.store(sh + at, active_coefficients), mr.store(m + at, active_coefficients);
                    vr.store(v + at, active_coefficients);
                }
            }
        }
    }
}

}  // namespace splat
