// Stage 4, blend: alpha blending of each tile's splats front to back, one 4×4 block at a time.
//
//     alpha = min(0.99, opacity p(t) exp(-½ dᵀ Σ2d⁻¹ d)),   w = alpha T,   C += w c,   T ← T - w
//
// The sixteen pixels of a block are the lanes. Their transmittance and colour stay in registers over the
// splats of a batch. `extra` is the number of channels beyond colour (depth, flow, statistics), a
// compile-time constant.
#pragma once

#include <algorithm>

#include "forward/tile.hpp"
#include "simd/vec_math.hpp"
#include "simd/vec_move.hpp"
#include "view_state.hpp"

namespace splat {

// A tile's place in the image and in the list of intersections.
struct TileSpan {
    int x, y;             // first pixel
    uint32_t begin, end;  // intersections
};
inline TileSpan tile_span(const ViewState& view, int tile) {
    return {tile % view.tiles_x * kTile, tile / view.tiles_x * kTile, view.tile_begin[tile],
            view.tile_begin[tile + 1]};
}

// Blending state of a block's pixels.
template <int extra>
struct BlockState {
    Float transmittance;
    Mask active;  // pixels whose transmittance has not run out
    Float channel[3 + extra];
};

// Blends splats indices[0..count-1] into one block. Returns after how many of them all pixels were done, or
// -1 if some are not. indices[count] and indices[count + 1] must be valid too.
template <int extra>
SPLAT_INLINE int blend_block(const Splat* splats, const scalar* extras, const uint32_t* indices, int count,
                             const Float& px, const Float& py, BlockState<extra>& state) {
    Float T = state.transmittance, C[3 + extra];
    Mask active = state.active;
    for (int k = 0; k < 3 + extra; ++k) C[k] = state.channel[k];
    auto alpha_of = [](const Float& power) {
        return zero_unless(power >= Float(kLog2MinAlpha), min(exp2_fast(power), kMaxAlpha));
    };
    int used = -1;
    // Alpha is computed one splat ahead, its logarithm two: the chain of all operations is too long for
    // out-of-order execution to overlap two splats.
    Float next_alpha = alpha_of(log2_alpha(splats[indices[0]], px, py)),
          next_power = log2_alpha(splats[indices[1]], px, py);
    for (int j = 0; j < count; ++j) {
        const Splat& s = splats[indices[j]];
        const Float alpha = next_alpha;
        next_alpha = alpha_of(next_power);
        next_power = log2_alpha(splats[indices[j + 2]], px, py);
        // Only T depends on the splat before, so its path is kept short: multiply, compare, mask.
        const Float next = T * (Float(1.f) - alpha);
        active = active & (next >= Float(kMinTransmittance));
        const Float w = zero_unless(active, alpha * T);
        T = select(active, next, T);
        C[0] += w * Float(s.r), C[1] += w * Float(s.g), C[2] += w * Float(s.b);
        if constexpr (extra > 0) {
            const scalar* value = extras + static_cast<size_t>(indices[j]) * kExtraStride;
            for (int e = 0; e < extra; ++e) C[3 + e] += w * Float(value[e]);
        }
        if (!bits(active)) [[unlikely]] {
            used = j + 1;
            break;
        }
    }
    state.transmittance = T;
    state.active = active;
    for (int k = 0; k < 3 + extra; ++k) state.channel[k] = C[k];
    return used;
}

// Intersections of a tile that are blended together; the splats of the next batch are prefetched meanwhile.
inline constexpr int kBatch = 256;
// Neighbouring tiles that one thread takes in sequence, so that its prefetches are for itself: 8, or fewer
// for many threads, so that none waits long for the last.
inline int tiles_together(const ViewState& view) {
    return std::clamp(view.tiles() / (32 * view.settings.threads), 1, 8);
}

template <int extra>
inline void blend_tile(ViewState& view, int tile, BlockState<extra> (&state)[kBlocks]) {
    const TileSpan span = tile_span(view, tile);
    for (int b = 0; b < kBlocks; ++b) {
        state[b].transmittance = 1.f;
        state[b].active = Float(1.f) > Float(0.f);
        for (auto& c : state[b].channel) c = 0.f;
        view.block_last[tile * kBlocks + b] = static_cast<scalar>(span.end - span.begin);
    }
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    unsigned active = 0xffff;  // blocks with an active pixel
    uint32_t block_splats[kBatch + kLanes];
    for (uint32_t first = span.begin; first < span.end && active; first += kBatch) {
        const int n = static_cast<int>(std::min<uint32_t>(kBatch, span.end - first));
        uint32_t ahead = first + n;
        const uint32_t next_end =
            ahead < span.end ? span.end : view.tile_begin[std::min(tile + 2, view.tiles())];
        const uint32_t ahead_end = std::min<uint32_t>(ahead + kBatch, next_end);
        const int share = static_cast<int>(ahead_end - ahead + 15) / 16;
        for (unsigned blocks = active; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            for (int k = 0; k < share && ahead < ahead_end; ++k, ++ahead)
                __builtin_prefetch(&view.splats[view.intersection_splat[ahead]]);
            const int count = compress_matching(&view.intersection_splat[first],
                                                &view.intersection_blocks[first], n, b, block_splats);
            if (count == 0) continue;
            block_splats[count] = block_splats[count + 1] = block_splats[count - 1];
            const Float px = lane_x + Float(static_cast<scalar>(span.x + b % 4 * kBlock));
            const Float py = lane_y + Float(static_cast<scalar>(span.y + b / 4 * kBlock));
            const int used = blend_block<extra>(view.splats.data(), view.extras.data(), block_splats, count,
                                                px, py, state[b]);
            if (used < 0) continue;
            active &= ~(1u << b);
            uint32_t last = first;
            while (view.intersection_splat[last] != block_splats[used - 1]) ++last;
            view.block_last[tile * kBlocks + b] = static_cast<scalar>(last + 1 - span.begin);
        }
    }
}

// Images as planes [height, width], or their gradients: color [3] over the background, alpha = 1 - T, and
// depth, flow [2], stats [2] as blended. Null: not rendered.
template <class T>
struct Planes {
    T* color;
    T* alpha;
    T* depth;
    T* flow;
    T* stats;
};
using OutputPlanes = Planes<scalar>;
using InputPlanes = Planes<const scalar>;

// The planes of the blended channels in order. Alpha is not among them.
template <class T>
inline void list_planes(const ViewState& view, const Planes<T>& p, T* (&planes)[3 + kMaxExtraChannels]) {
    const size_t size = static_cast<size_t>(view.camera.width) * view.camera.height;
    int channel = 0;
    auto add = [&](T* base, int count) {
        for (int k = 0; k < count; ++k) planes[channel++] = base ? base + k * size : nullptr;
    };
    add(p.color, 3);
    if (view.settings.depth) add(p.depth, 1);
    if (view.settings.flow) add(p.flow, 2);
    if (view.settings.stats) add(p.stats, 2);
}

template <int extra>
inline void write_tile(const ViewState& view, int tile, const BlockState<extra> (&state)[kBlocks],
                       const OutputPlanes& out) {
    const int width = view.camera.width, height = view.camera.height;
    scalar* planes[3 + kMaxExtraChannels];
    list_planes(view, out, planes);
    const TileSpan span = tile_span(view, tile);
    for (int first = 0; first < kBlocks; first += kBlock) {  // a row of four blocks
        const int y = span.y + first;
        Float block[kBlock];
        for (int k = 0; k < 3 + extra; ++k) {
            if (!planes[k]) continue;
            const Float background(k < 3 ? view.settings.background[k] : 0.f);
            for (int i = 0; i < kBlock; ++i)
                block[i] = state[first + i].channel[k] + state[first + i].transmittance * background;
            store_blocks(planes[k], width, height, span.x, y, block);
        }
        if (!out.alpha) continue;
        for (int i = 0; i < kBlock; ++i) block[i] = Float(1.f) - state[first + i].transmittance;
        store_blocks(out.alpha, width, height, span.x, y, block);
    }
}

template <int extra>
inline void blend(ViewState& view, const OutputPlanes& out) {
    StageTimer timer(view, kStageBlend);
    const int tiles = view.tiles();
    view.block_last.resize(static_cast<size_t>(tiles) * kBlocks);
    scalar* planes[3 + kMaxExtraChannels];
    list_planes(view, out, planes);
    const int together = tiles_together(view);
#pragma omp parallel for schedule(dynamic, together) num_threads(view.settings.threads)
    for (int tile = 0; tile < tiles; ++tile) {
        const TileSpan span = tile_span(view, tile);
        for (int k = 0; k < 3 + extra; ++k)
            if (planes[k])
                prefetch_for_writing(planes[k], view.camera.width, view.camera.height, span.x, span.y);
        BlockState<extra> state[kBlocks];
        blend_tile<extra>(view, tile, state);
        write_tile<extra>(view, tile, state, out);
    }
}

}  // namespace splat
