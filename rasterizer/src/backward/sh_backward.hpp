// Backward of forward/sh.hpp: from the colour gradients of a batch's views to those of SH coefficients.
//
// A view's gradient of a Gaussian's 48, 96 or 144 coefficients is an outer product of eight floats
// (ColorGradient). It is expanded here for a chunk of Gaussians at a time, summed over the views in their
// order, and used while it is in cache: by Adam in training, or copied out where the dense gradient is
// wanted.
#pragma once

#include <algorithm>
#include <vector>

#include "forward/sh_basis.hpp"

namespace splat {

// The colour gradients of one view's visible Gaussians.
struct ViewColors {
    uint32_t count;
    const int32_t* id;  // ascending
    const ColorGradient* gradient;
    int sh_degree, fourier_order;
    bool wrong_line;  // k_0,1,-1 gets the gradient of the constant k_0,0,0 (docs/baseline.md)
};

inline constexpr uint32_t kShChunk = 128;  // × 576 bytes: the expanded rows stay in the second-level cache

// Gradients of Gaussians [first, last), `orders` rows of three Floats each. touched[i]: some view shows it.
struct ShGradientChunk {
    explicit ShGradientChunk(int orders) : orders(orders), rows(static_cast<size_t>(kShChunk) * orders) {}
    int orders;
    std::vector<ShRow> rows;
    bool touched[kShChunk];
};

// Coefficient 1 gets what coefficient 0 has.
inline void repeat_constant(ShRow& row) {
    alignas(64) scalar lane[kLanes];
    row.v[0].store(lane);
    for (int c = 0; c < 3; ++c) lane[3 + c] = lane[c];
    row.v[0] = Float::load(lane);
}

inline void expand_sh_gradient(const std::vector<ViewColors>& views, uint32_t first, uint32_t last,
                               ShGradientChunk& out) {
    std::fill_n(out.touched, last - first, false);
    for (const ViewColors& view : views) {
        const int32_t* end = view.id + view.count;
        const int32_t* from = std::lower_bound(view.id, end, static_cast<int32_t>(first));
        const int32_t* to = std::lower_bound(from, end, static_cast<int32_t>(last));
        for (const int32_t* at = from; at < to; at += kLanes) {
            const int n = static_cast<int>(std::min<ptrdiff_t>(kLanes, to - at));
            const ColorGradient* gradient = view.gradient + (at - view.id);
            Float column[16], basis[16];
            for (int l = 0; l < kLanes; ++l)
                column[l] = l < n ? Float::load_first(gradient[l].color, 8) : Float(0.f);
            transpose(column);
            sh_basis(column[3], column[4], column[5], view.sh_degree, basis);
            transpose(basis);  // now a Float per Gaussian, lm in its lanes
            for (int l = 0; l < n; ++l) {
                const uint32_t i = static_cast<uint32_t>(at[l]) - first;
                ShRow* row = &out.rows[static_cast<size_t>(i) * out.orders];
                const Float rgb = Float::load_first(gradient[l].color, 3);
                ShRow g;
                for (int v = 0; v < kRowVectors; ++v)
                    g.v[v] = permute(basis[l], kRowLanes.coefficient[v]) * permute(rgb, kRowLanes.channel[v]);
                ShRow order0 = g;
                if (view.wrong_line && view.sh_degree > 0) [[unlikely]]
                    repeat_constant(order0);
                if (out.touched[i])
                    row[0] += order0;
                else
                    row[0] = order0;
                for (int k = 1; k < out.orders; ++k) {
                    const Float cosine(k <= view.fourier_order ? gradient[l].cosine[k - 1] : 0.f);
                    if (out.touched[i])
                        row[k] += g * cosine;
                    else
                        row[k] = g * cosine;
                }
                out.touched[i] = true;
            }
        }
    }
    for (uint32_t i = 0; i < last - first; ++i)
        if (!out.touched[i])
            std::fill_n(&out.rows[static_cast<size_t>(i) * out.orders], out.orders, ShRow::zero());
}

// The dense gradient [N, stored orders · coefficients, 3]. Whole cache lines are streamed past the caches
// (W1: 4.8 instead of 9.4 ms).
inline void dense_sh_gradient(const std::vector<ViewColors>& views, uint32_t count, int coefficients,
                              int orders, scalar* dense, int threads) {
    const size_t order_stride = static_cast<size_t>(coefficients) * 3;
    const bool whole_lines = coefficients == 16 && reinterpret_cast<uintptr_t>(dense) % 64 == 0;
#pragma omp parallel num_threads(threads)
    {
        ShGradientChunk chunk(orders);
#pragma omp for schedule(static)
        for (uint32_t first = 0; first < count; first += kShChunk) {
            const uint32_t last = std::min(count, first + kShChunk);
            expand_sh_gradient(views, first, last, chunk);
            for (size_t k = 0; k < static_cast<size_t>(last - first) * orders; ++k) {
                scalar* to = dense + (static_cast<size_t>(first) * orders + k) * order_stride;
                if (whole_lines)
                    for (int v = 0; v < kRowVectors; ++v) chunk.rows[k].v[v].stream(to + v * kLanes);
                else
                    chunk.rows[k].store(to, coefficients);
            }
        }
        end_of_streaming();
    }
}

}  // namespace splat
