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

// Alpha of an intersection's pixels, 0 below the threshold, and their u and v, by block.
struct IntersectionAlpha {
    unsigned blocks;  // those that the splat touches and that have pixels left
    Float alpha[kBlocks], u[kBlocks], v[kBlocks];
};

// Σ a b over the pixels, and Σ a, in a register's lanes.
SPLAT_INLINE void add_products(NativeFloat& sum, const Float& a, const Float& b) {
    for (int i = 0; i < kParts; ++i) sum += a.part[i] * b.part[i];
}
SPLAT_INLINE void add_values(NativeFloat& sum, const Float& a) {
    for (int i = 0; i < kParts; ++i) sum += a.part[i];
}

template <int extra>
inline void blend_backward_tile(ViewState& view, int tile, const InputPlanes& rendered,
                                const InputPlanes& d) {
    const TileSpan span = tile_span(view, tile);
    if (span.begin == span.end) return;
    TileGradientState<extra> state;
    load_image_gradients<extra>(view, span, rendered, d, state);
    const Float block_last = Float::load(&view.block_last[static_cast<size_t>(tile) * kBlocks]);
    const Float px0 = Float::load(kBlockPixel.x) + Float(static_cast<scalar>(span.x)),
                py0 = Float::load(kBlockPixel.y) + Float(static_cast<scalar>(span.y));
    auto compute_alpha = [&](uint32_t e, IntersectionAlpha& out) __attribute__((always_inline)) {
        const uint32_t ahead = std::min(e + kPrefetchedSplats, span.end - 1);
        __builtin_prefetch(&view.splats[view.intersection_splat[ahead]]);
        const Splat& s = view.splats[view.intersection_splat[e]];
        out.blocks =
            view.intersection_blocks[e] & bits(block_last > Float(static_cast<scalar>(e - span.begin)));
        for (unsigned blocks = out.blocks; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            const Float px = px0 + Float(kBlockCorner.x[b]), py = py0 + Float(kBlockCorner.y[b]);
            const Float u = sheared_dx(s, px, py), v = py - Float(s.y), power = log2_alpha_at(s, u, v);
            out.alpha[b] = zero_unless(power >= Float(kLog2MinAlpha), min(exp2_fast(power), kMaxAlpha));
            out.u[b] = u, out.v[b] = v;
        }
    };
    constexpr int kFields = kGradientFields + extra, kGroups = (kFields + 3) / 4;
    // Alpha is computed one intersection ahead, since the chain of operations from it to the sums is long.
    IntersectionAlpha computed[2];
    compute_alpha(span.begin, computed[0]);
    for (uint32_t e = span.begin; e < span.end; ++e) {
        const IntersectionAlpha& at = computed[(e - span.begin) % 2];
        if (e + 1 < span.end) compute_alpha(e + 1, computed[(e + 1 - span.begin) % 2]);
        const uint32_t splat_index = view.intersection_splat[e];
        const Splat& s = view.splats[splat_index];
        const scalar* value =
            extra ? view.extras.data() + static_cast<size_t>(splat_index) * kExtraStride : nullptr;
        NativeFloat sum[4 * kGroups] = {};
        for (unsigned blocks = at.blocks; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            const Float T = state.transmittance[b], one_minus_alpha = Float(1.f) - at.alpha[b],
                        next = T * one_minus_alpha;
            const Mask active = next >= Float(kMinTransmittance);
            const Float alpha = zero_unless(active, at.alpha[b]), w = alpha * T;
            state.transmittance[b] = zero_unless(active, next);
            Float gradient_dot_color = state.gradient[0][b] * Float(s.r) + state.gradient[1][b] * Float(s.g) +
                                       state.gradient[2][b] * Float(s.b);
            for (int k = 0; k < extra; ++k) gradient_dot_color += state.gradient[3 + k][b] * Float(value[k]);
            const Float remaining = state.remaining[b] - w * gradient_dot_color;
            state.remaining[b] = remaining;
            const Float d_alpha = T * gradient_dot_color - remaining * fast_inverse(one_minus_alpha);
            // 0 where alpha is clamped
            const Float d_log_alpha = zero_unless(Float(kMaxAlpha) > alpha, alpha * d_alpha);
            const Float u = at.u[b], v = at.v[b], moment_u = d_log_alpha * u, moment_v = d_log_alpha * v;
            add_products(sum[kGradR], w, state.gradient[0][b]);
            add_products(sum[kGradG], w, state.gradient[1][b]);
            add_products(sum[kGradB], w, state.gradient[2][b]);
            add_values(sum[kGradLogAlpha], d_log_alpha);
            add_values(sum[kMomentU], moment_u);
            add_values(sum[kMomentV], moment_v);
            add_products(sum[kMomentUU], moment_u, u);
            add_products(sum[kMomentUV], moment_u, v);
            add_products(sum[kMomentVV], moment_v, v);
            for (int k = 0; k < extra; ++k) add_products(sum[kGradExtra + k], w, state.gradient[3 + k][b]);
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
