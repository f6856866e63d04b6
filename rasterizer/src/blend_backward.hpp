// Backward of stage 4: from image gradients to one gradient slot per (tile, Gaussian) entry.
//
// Gaussian by Gaussian, front to back as in blend.hpp. With g the image gradient of a pixel and Q the still
// unblended part of Σ_k g_k C_k (background and alpha included), blending splat i gives
//     Q ← Q - w g·c_i,        ∂L/∂alpha_i = T g·c_i - Q / (1 - alpha_i),
// so nothing is stored per contribution and nothing is read backwards. Each entry owns its slot: no atomics,
// and the same bits for any number of threads.
#pragma once

#include "blend.hpp"

namespace splat {

template <int extra>
struct Unblended {
    Float transmittance[kBlocks];  // 0 once a pixel has ended: nothing more is blended there
    Float rest[kBlocks];           // Q
    Float gradient[3 + extra][kBlocks];
};

// rendered: the images of the forward pass. d: ∂L/∂ them, null: zero.
template <int extra>
inline void start_tile(const Frame& f, const TileSpan& span, const InputPlanes& rendered,
                       const InputPlanes& d, Unblended<extra>& u) {
    const int width = f.camera.width, height = f.camera.height;
    const scalar *image[3 + kMaxExtra], *gradient[3 + kMaxExtra];
    list_planes(f, rendered, image);
    list_planes(f, d, gradient);
    for (int first = 0; first < kBlocks; first += kBlock) {  // a row of four blocks
        const int y = span.y + first;
        Float g[kBlock], value[kBlock], rest[kBlock] = {0.f, 0.f, 0.f, 0.f};
        for (int k = 0; k < 3 + extra; ++k) {
            load_blocks(gradient[k], width, height, span.x, y, g);
            load_blocks(image[k], width, height, span.x, y, value);
            for (int i = 0; i < kBlock; ++i) {
                u.gradient[k][first + i] = g[i];
                rest[i] += g[i] * value[i];
            }
        }
        if (d.alpha) {  // alpha = 1 - T, and T is blended like a colour behind everything
            load_blocks(d.alpha, width, height, span.x, y, g);
            load_blocks(rendered.alpha, width, height, span.x, y, value);
            for (int i = 0; i < kBlock; ++i) rest[i] -= g[i] * (Float(1.f) - value[i]);
        }
        for (int i = 0; i < kBlock; ++i) {
            u.rest[first + i] = rest[i];
            u.transmittance[first + i] = 1.f;
        }
    }
}

// Entries whose splats are fetched ahead: of 2, 3, 4, 6, 12 and 24 the quickest on W1 and W2 (12 costs W2 an
// eighth).
inline constexpr uint32_t kEntryPrefetch = 4;

template <int extra>
inline void blend_backward_tile(Frame& f, int tile, const InputPlanes& rendered, const InputPlanes& d) {
    const TileSpan span = tile_span(f, tile);
    if (span.begin == span.end) return;
    Unblended<extra> u;
    start_tile<extra>(f, span, rendered, d, u);
    const Float last = Float::load(&f.blocks_last[static_cast<size_t>(tile) * kBlocks]);
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    constexpr int kFields = kSlotFields + extra, kGroups = (kFields + 3) / 4;
    for (uint32_t e = span.begin; e < span.end; ++e) {
        const uint32_t ahead = std::min(e + kEntryPrefetch, span.end - 1);
        __builtin_prefetch(&f.staged[f.entry_splat[ahead]]);
        const uint32_t place = f.entry_splat[e];
        const Splat& s = f.staged[place];
        const scalar* value = f.extras.data() + static_cast<size_t>(place) * kExtraStride;
        Float sum[4 * kGroups];
        for (auto& v : sum) v = 0.f;
        const Float px0 = lane_x + Float(static_cast<scalar>(span.x)),
                    py0 = lane_y + Float(static_cast<scalar>(span.y));
        unsigned blocks = f.entry_mask[e] & bits(last > Float(static_cast<scalar>(e - span.begin)));
        for (; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            const Float px = px0 + Float(kBlockCorner.x[b]), py = py0 + Float(kBlockCorner.y[b]);
            const Float across = across_of(s, px, py), along_axis = py - Float(s.y);
            const Float power = log2_alpha_of(s, across, along_axis), T = u.transmittance[b],
                        peak = exp2_fast(power);
            Float alpha = zero_unless(power >= Float(kLog2MinAlpha), min(peak, kMaxAlpha));
            const Float through = Float(1.f) - alpha, next = T * through;
            const Mask live = next >= Float(kMinTransmittance);
            const Float w = zero_unless(live, alpha * T);
            u.transmittance[b] = zero_unless(live, next);
            Float along =
                u.gradient[0][b] * Float(s.r) + u.gradient[1][b] * Float(s.g) + u.gradient[2][b] * Float(s.b);
            for (int k = 0; k < extra; ++k) along += u.gradient[3 + k][b] * Float(value[k]);
            const Float rest = u.rest[b] - w * along;
            u.rest[b] = rest;
            const Float d_alpha = T * along - rest * fast_inverse(through);
            const Float d_power =
                zero_unless(live & (Float(kMaxAlpha) >= peak), alpha * d_alpha);  // of ln alpha
            const Float m_across = d_power * across, m_along = d_power * along_axis;
            sum[kSlotR] += w * u.gradient[0][b];
            sum[kSlotG] += w * u.gradient[1][b];
            sum[kSlotB] += w * u.gradient[2][b];
            sum[kSlotPower] += d_power;
            sum[kSlotAcross] += m_across;
            sum[kSlotAlong] += m_along;
            sum[kSlotAcross2] += m_across * across;
            sum[kSlotBoth] += m_across * along_axis;
            sum[kSlotAlong2] += m_along * along_axis;
            for (int k = 0; k < extra; ++k) sum[kSlotExtra + k] += w * u.gradient[3 + k][b];
        }
        sum_lanes<kGroups>(sum).stream(f.slots[f.entry_slot[e]].value);
    }
}

template <int extra>
inline void blend_backward(Frame& f, const InputPlanes& rendered, const InputPlanes& d) {
    StageTimer timer(f, kStageBlendBackward);
    f.slots.resize(f.entry_slot.size());
#pragma omp parallel num_threads(f.settings.threads)
    {
#pragma omp for schedule(dynamic, kTilesTogether)
        for (int tile = 0; tile < f.tiles(); ++tile) blend_backward_tile<extra>(f, tile, rendered, d);
        end_of_streaming();
    }
}

}  // namespace splat
