// Stage 4: blending front to back, block by block.
//
//     alpha = min(0.99, opacity p(t) exp(-½ dᵀ Σ2d⁻¹ d)),   w = alpha T,   C += w c,   T ← T - w
//
// A block's sixteen pixels are the lanes; its transmittance and colour stay in registers while its part of
// the tile's list goes by. `extra` is how many channels beyond colour are blended (depth, flow, statistics):
// none costs nothing.
#pragma once

#include <algorithm>

#include "blocks.hpp"
#include "frame.hpp"
#include "vec_math.hpp"
#include "vec_move.hpp"

namespace splat {

struct TileSpan {
    int x, y;             // first pixel
    uint32_t begin, end;  // entries
};
inline TileSpan tile_span(const Frame& f, int tile) {
    return {tile % f.tiles_x * kTile, tile / f.tiles_x * kTile, f.tile_begin[tile], f.tile_begin[tile + 1]};
}

template <int extra>
struct Blended {
    Float transmittance;
    Mask open;  // pixels that have not ended
    Float channel[3 + extra];
};

// Blends splats places[0..count-1] into one block; returns how many it took until every pixel had ended, else
// -1. places[count] is looked at too.
template <int extra>
SPLAT_INLINE int blend_block(const Splat* splats, const scalar* extras, const uint32_t* places, int count,
                             const Float& px, const Float& py, Blended<extra>& state) {
    Float T = state.transmittance, C[3 + extra];
    Mask open = state.open;
    for (int k = 0; k < 3 + extra; ++k) C[k] = state.channel[k];
    auto alpha_of = [&](const Splat& s) {
        const Float power = log2_alpha(s, px, py);
        return zero_unless(power >= Float(kLog2MinAlpha), min(exp2_fast(power), kMaxAlpha));
    };
    int used = -1;
    // One splat ahead: the way to alpha is too long a chain for a processor to begin the next by itself (a
    // tenth of a hot tile's time).
    Float upcoming = alpha_of(splats[places[0]]);
    for (int j = 0; j < count; ++j) {
        const Splat& s = splats[places[j]];
        const Float alpha = upcoming;
        upcoming = alpha_of(splats[places[j + 1]]);
        // What one splat waits for of the one before it is T alone, so its path is kept short: multiply,
        // compare, mask.
        const Float next = T * (Float(1.f) - alpha);
        open = open & (next >= Float(kMinTransmittance));
        const Float w = zero_unless(open, alpha * T);
        T = select(open, next, T);
        C[0] += w * Float(s.r), C[1] += w * Float(s.g), C[2] += w * Float(s.b);
        if constexpr (extra > 0) {
            const scalar* value = extras + static_cast<size_t>(places[j]) * kExtraStride;
            for (int e = 0; e < extra; ++e) C[3 + e] += w * Float(value[e]);
        }
        if (!bits(open)) [[unlikely]] {
            used = j + 1;
            break;
        }
    }
    state.transmittance = T;
    state.open = open;
    for (int k = 0; k < 3 + extra; ++k) state.channel[k] = C[k];
    return used;
}

// Entries whose splats are fetched while a block is blended: the next batch's.
inline constexpr int kBatch = 256;
// Neighbours in a row that one thread takes one after another, so that what is fetched ahead is its own.
inline constexpr int kTilesTogether = 8;

template <int extra>
inline void blend_tile(Frame& f, int tile, Blended<extra> (&state)[kBlocks]) {
    const TileSpan span = tile_span(f, tile);
    for (int b = 0; b < kBlocks; ++b) {
        state[b].transmittance = 1.f;
        state[b].open = Float(1.f) > Float(0.f);
        for (auto& c : state[b].channel) c = 0.f;
        f.blocks_last[tile * kBlocks + b] = static_cast<scalar>(span.end - span.begin);
    }
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    unsigned open = 0xffff;  // blocks with a pixel that has not ended
    uint32_t packed[kBatch + kLanes];
    for (uint32_t first = span.begin; first < span.end && open; first += kBatch) {
        const int n = static_cast<int>(std::min<uint32_t>(kBatch, span.end - first));
        uint32_t ahead = first + n;
        const uint32_t next_end = ahead < span.end ? span.end : f.tile_begin[std::min(tile + 2, f.tiles())];
        const uint32_t ahead_end = std::min<uint32_t>(ahead + kBatch, next_end);
        const int share = static_cast<int>(ahead_end - ahead + 15) / 16;
        for (unsigned blocks = open; blocks; blocks &= blocks - 1) {
            const int b = __builtin_ctz(blocks);
            for (int k = 0; k < share && ahead < ahead_end; ++k, ++ahead)
                __builtin_prefetch(&f.staged[f.entry_splat[ahead]]);
            const int count = pack_matching(&f.entry_splat[first], &f.entry_mask[first], n, b, packed);
            if (count == 0) continue;
            packed[count] = packed[count - 1];
            const Float px = lane_x + Float(static_cast<scalar>(span.x + b % 4 * kBlock));
            const Float py = lane_y + Float(static_cast<scalar>(span.y + b / 4 * kBlock));
            const int used =
                blend_block<extra>(f.staged.data(), f.extras.data(), packed, count, px, py, state[b]);
            if (used < 0) continue;
            open &= ~(1u << b);
            uint32_t last = first;
            while (f.entry_splat[last] != packed[used - 1]) ++last;
            f.blocks_last[tile * kBlocks + b] = static_cast<scalar>(last + 1 - span.begin);
        }
    }
}

// Images as planes [height, width], or what the loss says of them. color [3] over the background; alpha = 1 -
// T; depth, flow [2], stats [2] as blended. Null: not wanted.
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

// The planes of the blended channels in their order; alpha is none of them.
template <class T>
inline void list_planes(const Frame& f, const Planes<T>& p, T* (&planes)[3 + kMaxExtra]) {
    const size_t size = static_cast<size_t>(f.camera.width) * f.camera.height;
    int channel = 0;
    auto add = [&](T* base, int count) {
        for (int k = 0; k < count; ++k) planes[channel++] = base ? base + k * size : nullptr;
    };
    add(p.color, 3);
    if (f.settings.depth) add(p.depth, 1);
    if (f.settings.flow) add(p.flow, 2);
    if (f.settings.stats) add(p.stats, 2);
}

template <int extra>
inline void write_tile(const Frame& f, int tile, const Blended<extra> (&state)[kBlocks],
                       const OutputPlanes& out) {
    const int width = f.camera.width, height = f.camera.height;
    scalar* planes[3 + kMaxExtra];
    list_planes(f, out, planes);
    const TileSpan span = tile_span(f, tile);
    for (int first = 0; first < kBlocks; first += kBlock) {  // a row of four blocks
        const int y = span.y + first;
        Float block[kBlock];
        for (int k = 0; k < 3 + extra; ++k) {
            if (!planes[k]) continue;
            const Float background(k < 3 ? f.settings.background[k] : 0.f);
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
inline void blend(Frame& f, const OutputPlanes& out) {
    StageTimer timer(f, kStageBlend);
    const int tiles = f.tiles();
    f.blocks_last.resize(static_cast<size_t>(tiles) * kBlocks);
    scalar* planes[3 + kMaxExtra];
    list_planes(f, out, planes);
#pragma omp parallel for schedule(dynamic, kTilesTogether) num_threads(f.settings.threads)
    for (int tile = 0; tile < tiles; ++tile) {
        const TileSpan span = tile_span(f, tile);
        for (int k = 0; k < 3 + extra; ++k)
            if (planes[k]) prefetch_for_writing(planes[k], f.camera.width, f.camera.height, span.x, span.y);
        Blended<extra> state[kBlocks];
        blend_tile<extra>(f, tile, state);
        write_tile<extra>(f, tile, state, out);
    }
}

}  // namespace splat
