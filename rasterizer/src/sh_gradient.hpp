// The gradient of the SH coefficients of a batch, from the compact colour gradients its views left.
//
// A view's gradient of a Gaussian's 48, 96 or 144 coefficients is an outer product of eight floats
// (ColorGradient); it is expanded here for a few hundred Gaussians at a time, summed over the batch's views
// in their order, and consumed while it is in cache: by Adam in training, by a plain copy where the dense
// gradient is asked for.
#pragma once

#include <algorithm>
#include <vector>

#include "sh.hpp"

namespace splat {

struct ViewColors {
    uint32_t count;
    const int32_t* id;  // ascending
    const ColorGradient* gradient;
    int sh_degree, fourier_order;
};

inline constexpr uint32_t kShChunk = 128;  // × 576 bytes: the expanded rows stay in the second-level cache

// Expanded gradients of Gaussians [first, last), `orders` rows of three Floats each; touched[i]: some view
// saw it.
struct ExpandedChunk {
    explicit ExpandedChunk(int orders) : orders(orders), rows(static_cast<size_t>(kShChunk) * orders) {}
    int orders;
    std::vector<ShRow> rows;
    bool touched[kShChunk];
};

inline void expand(const std::vector<ViewColors>& views, uint32_t first, uint32_t last, ExpandedChunk& out) {
    for (uint32_t i = 0; i < last - first; ++i) out.touched[i] = false;
    for (auto& row : out.rows)
        for (auto& v : row.v) v = 0.f;
    for (const ViewColors& view : views) {
        const int32_t* end = view.id + view.count;
        const int32_t* from = std::lower_bound(view.id, end, static_cast<int32_t>(first));
        const int32_t* to = std::lower_bound(from, end, static_cast<int32_t>(last));
        for (const int32_t* at = from; at < to; at += kLanes) {
            const int n = static_cast<int>(std::min<ptrdiff_t>(kLanes, to - at));
            const ColorGradient* gradient = view.gradient + (at - view.id);
            Float column[16];
            for (int l = 0; l < kLanes; ++l)
                column[l] = l < n ? Float::load_first(gradient[l].color, 8) : Float(0.f);
            transpose(column);
            Float basis[16], spread[kRowVectors][16], channels[kRowVectors][16];
            sh_basis(column[3], column[4], column[5], view.sh_degree, basis);
            spread_basis(basis, spread);
            const Float rgb[3] = {column[0], column[1], column[2]};
            spread_channels(rgb, channels);
            for (int l = 0; l < n; ++l) {
                const uint32_t i = static_cast<uint32_t>(at[l]) - first;
                out.touched[i] = true;
                ShRow* row = &out.rows[static_cast<size_t>(i) * out.orders];
                for (int v = 0; v < kRowVectors; ++v) {
                    const Float g = spread[v][l] * channels[v][l];
                    row[0].v[v] += g;
                    for (int k = 1; k <= view.fourier_order && k < out.orders; ++k)
                        row[k].v[v] += g * Float(gradient[l].cosine[k - 1]);
                }
            }
        }
    }
}

// Dense gradient [N, stored orders · coefficients, 3].
inline void expand_dense(const std::vector<ViewColors>& views, uint32_t count, int coefficients, int orders,
                         float* dense, int threads) {
    const size_t order_stride = static_cast<size_t>(coefficients) * 3;
#pragma omp parallel num_threads(threads)
    {
        ExpandedChunk chunk(orders);
#pragma omp for schedule(static)
        for (uint32_t first = 0; first < count; first += kShChunk) {
            const uint32_t last = std::min(count, first + kShChunk);
            expand(views, first, last, chunk);
            for (uint32_t i = first; i < last; ++i)
                for (int n = 0; n < orders; ++n)
                    chunk.rows[static_cast<size_t>(i - first) * orders + n].store(
                        dense + (static_cast<size_t>(i) * orders + n) * order_stride, coefficients);
        }
    }
}

}  // namespace splat
