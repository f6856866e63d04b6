// Backward of forward/blend.hpp: from image gradients to the gradient of each (tile, splat) intersection.
//
// Splats are visited front to back, as in the forward pass. With g the image gradient of a pixel, and Q the
// part of Σ_k g_k C_k that is not yet blended (background and alpha included), blending splat i gives
//     Q ← Q - w g·c_i,        ∂L/∂alpha_i = T g·c_i - Q / (1 - alpha_i).
// So the forward pass stores nothing per contribution, and no list is read backwards. Each intersection has a
// gradient of its own: no atomics, and the same bits for any number of threads.
#pragma once

#include "forward/blend.hpp"

namespace splat {

// State of a tile's pixels, in blocks.
template <int extra>
struct TileGradientState {
    Float transmittance[kBlocks];  // 0 once a pixel is done
    Float remaining[kBlocks];      // Q
    Float gradient[3 + extra][kBlocks];
};

// rendered: the images of the forward pass. d: their gradients; null counts as zero.
template <int extra>
inline void load_image_gradients(const ViewState& view, const TileSpan& span, const InputPlanes& rendered,
                                 const InputPlanes& d, TileGradientState<extra>& state) {
    const int width = view.camera.width, height = view.camera.height;
    const scalar *image[3 + kMaxExtraChannels], *gradient[3 + kMaxExtraChannels];
    list_planes(view, rendered, image);
    list_planes(view, d, gradient);
    for (int first = 0; first < kBlocks; first += kBlock) {  // a row of four blocks
        const int y = span.y + first;
        Float g[kBlock], value[kBlock], remaining[kBlock] = {0.f, 0.f, 0.f, 0.f};
        for (int k = 0; k < 3 + extra; ++k) {
            load_blocks(gradient[k], width, height, span.x, y, g);
            load_blocks(image[k], width, height, span.x, y, value);
            for (int i = 0; i < kBlock; ++i) {
                state.gradient[k][first + i] = g[i];
                remaining[i] += g[i] * value[i];
            }
        }
        if (d.alpha) {  // alpha = 1 - T, and T blends like a background
            load_blocks(d.alpha, width, height, span.x, y, g);
            load_blocks(rendered.alpha, width, height, span.x, y, value);
            for (int i = 0; i < kBlock; ++i) remaining[i] -= g[i] * (Float(1.f) - value[i]);
        }
        for (int i = 0; i < kBlock; ++i) {
            state.remaining[first + i] = remaining[i];
            state.transmittance[first + i] = 1.f;
        }
    }
}

// Splats prefetched ahead: the fastest of 2, 3, 4, 6, 12 and 24 on W1 and W2 (W2 with 12: an eighth longer).
inline constexpr uint32_t kPrefetchedSplats = 4;

template <int extra>
inline void blend_backward_tile(ViewState& view, int tile, const InputPlanes& rendered,
                                const InputPlanes& d) {
    const TileSpan span = tile_span(view, tile);
    if (span.begin == span.end) return;
    TileGradientState<extra> state;
    load_image_gradients<extra>(view, span, rendered, d, state);
    const Float block_last = Float::load(&view.block_last[static_cast<size_t>(tile) * kBlocks]);
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    constexpr int kFields = kGradientFields + extra, kGroups = (kFields + 3) / 4;
    for (uint32_t e = span.begin; e < span.end; ++e) {
        const uint32_t ahead = std::min(e + kPrefetchedSplats, span.end - 1);
        __builtin_prefetch(&view.splats[view.intersection_splat[ahead]]);
        const uint32_t splat_index = view.intersection_splat[e];
        const Splat& s = view.splats[splat_index];
        const scalar* value =
            extra ? view.extras.data() + static_cast<size_t>(splat_index) * kExtraStride : nullptr;
        Float sum[4 * kGroups];
        for (auto& v : sum) v = 0.f;
        const Float px0 = lane_x + Float(static_cast<scalar>(span.x)),
                    py0 = lane_y + Float(static_cast<scalar>(span.y));
        unsigned blocks =
            view.intersection_blocks[e] & bits(block_last > Float(static_cast<scalar>(e - span.begin)));
        for (; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            const Float px = px0 + Float(kBlockCorner.x[b]), py = py0 + Float(kBlockCorner.y[b]);
            const Float u = sheared_dx(s, px, py), v = py - Float(s.y);
            const Float power = log2_alpha_at(s, u, v), T = state.transmittance[b],
                        unclamped_alpha = exp2_fast(power);
            Float alpha = zero_unless(power >= Float(kLog2MinAlpha), min(unclamped_alpha, kMaxAlpha));
            const Float one_minus_alpha = Float(1.f) - alpha, next = T * one_minus_alpha;
            const Mask active = next >= Float(kMinTransmittance);
            const Float w = zero_unless(active, alpha * T);
            state.transmittance[b] = zero_unless(active, next);
            Float gradient_dot_color = state.gradient[0][b] * Float(s.r) + state.gradient[1][b] * Float(s.g) +
                                       state.gradient[2][b] * Float(s.b);
            for (int k = 0; k < extra; ++k) gradient_dot_color += state.gradient[3 + k][b] * Float(value[k]);
            const Float remaining = state.remaining[b] - w * gradient_dot_color;
            state.remaining[b] = remaining;
            const Float d_alpha = T * gradient_dot_color - remaining * fast_inverse(one_minus_alpha);
            const Float d_log_alpha =
                zero_unless(active & (Float(kMaxAlpha) >= unclamped_alpha), alpha * d_alpha);
            const Float moment_u = d_log_alpha * u, moment_v = d_log_alpha * v;
            sum[kGradR] += w * state.gradient[0][b];
            sum[kGradG] += w * state.gradient[1][b];
            sum[kGradB] += w * state.gradient[2][b];
            sum[kGradLogAlpha] += d_log_alpha;
            sum[kMomentU] += moment_u;
            sum[kMomentV] += moment_v;
            sum[kMomentUU] += moment_u * u;
            sum[kMomentUV] += moment_u * v;
            sum[kMomentVV] += moment_v * v;
            for (int k = 0; k < extra; ++k) sum[kGradExtra + k] += w * state.gradient[3 + k][b];
        }
        sum_lanes<kGroups>(sum).stream(view.intersection_gradients[view.gradient_index[e]].value);
    }
}

template <int extra>
inline void blend_backward(ViewState& view, const InputPlanes& rendered, const InputPlanes& d) {
    StageTimer timer(view, kStageBlendBackward);
    view.intersection_gradients.resize(view.gradient_index.size());
    const int together = tiles_together(view);
#pragma omp parallel num_threads(view.settings.threads)
    {
#pragma omp for schedule(dynamic, together)
        for (int tile = 0; tile < view.tiles(); ++tile) blend_backward_tile<extra>(view, tile, rendered, d);
        end_of_streaming();
    }
}

}  // namespace splat
