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

// log2 of alpha before its cap, at (dx, dy) from the splat's mean.
SPLAT_INLINE Float log2_alpha(const Splat& s, const Float& dx, const Float& dy) {
    return dx * (dx * Float(s.xx) + dy * Float(s.xy)) + (dy * dy * Float(s.yy) + Float(s.log2_opacity));
}

struct TileSpan {
    int x, y;             // first pixel
    uint32_t begin, end;  // entries
};
inline TileSpan tile_span(const Frame& f, int tile) {
    return {tile % f.tiles_x * kTile, tile / f.tiles_x * kTile, f.tile_begin[tile], f.tile_begin[tile + 1]};
}

// Where the channels of a tile's blocks are kept.
inline size_t block_at(const Frame& f, int tile, int channel, int block) {
    return (static_cast<size_t>(tile) * f.channels() + channel) * kTilePixels + block * kLanes;
}

template <int extra>
struct Blended {
    Float transmittance;  // 0 once a pixel has ended: nothing more is blended there
    Float left;           // the transmittance that stays in the end
    Float channel[3 + extra];
};

// Blends `count` splats into one block; returns how many it took until every pixel had ended, else -1.
template <int extra>
SPLAT_INLINE int blend_block(const Splat* splats, const float* extras, const uint32_t* places, int count,
                             const Float& px, const Float& py, Blended<extra>& state) {
    Float T = state.transmittance, left = state.left, C[3 + extra];
    for (int k = 0; k < 3 + extra; ++k) C[k] = state.channel[k];
    int used = -1;
    for (int j = 0; j < count; ++j) {
        const Splat& s = splats[places[j]];
        Float power = log2_alpha(s, px - Float(s.x), py - Float(s.y));
        Float alpha = zero_unless(power >= Float(kLog2MinAlpha), min(exp2(power), kMaxAlpha));
        // What one splat waits for of the one before it is T alone, so its path is kept short: multiply,
        // compare, mask.
        Float next = T * (Float(1.f) - alpha);
        Mask live = next >= Float(kMinTransmittance);
        Float w = zero_unless(live, alpha * T);
        T = zero_unless(live, next);
        left = select(live, next, left);
        C[0] += w * Float(s.r), C[1] += w * Float(s.g), C[2] += w * Float(s.b);
        if constexpr (extra > 0) {
            const float* value = extras + static_cast<size_t>(places[j]) * kExtraStride;
            for (int e = 0; e < extra; ++e) C[3 + e] += w * Float(value[e]);
        }
        if (!bits(live)) [[unlikely]] {
            used = j + 1;
            break;
        }
    }
    state.transmittance = T;
    state.left = left;
    for (int k = 0; k < 3 + extra; ++k) state.channel[k] = C[k];
    return used;
}

// Entries whose splats are fetched while a block is blended: the next batch's.
inline constexpr int kBatch = 256;

template <int extra>
inline void blend_tile(Frame& f, int tile) {
    const TileSpan span = tile_span(f, tile);
    Blended<extra> state[kBlocks];
    for (int b = 0; b < kBlocks; ++b) {
        state[b].transmittance = state[b].left = 1.f;
        for (auto& c : state[b].channel) c = 0.f;
        f.blocks_last[tile * kBlocks + b] = static_cast<float>(span.end - span.begin);
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
            const Float px = lane_x + Float(static_cast<float>(span.x + b % 4 * kBlock));
            const Float py = lane_y + Float(static_cast<float>(span.y + b / 4 * kBlock));
            const int used =
                blend_block<extra>(f.staged.data(), f.extras.data(), packed, count, px, py, state[b]);
            if (used < 0) continue;
            open &= ~(1u << b);
            uint32_t last = first;
            while (f.entry_splat[last] != packed[used - 1]) ++last;
            f.blocks_last[tile * kBlocks + b] = static_cast<float>(last + 1 - span.begin);
        }
    }
    for (int b = 0; b < kBlocks; ++b) {
        for (int k = 0; k < 3 + extra; ++k) state[b].channel[k].store(&f.image[block_at(f, tile, k, b)]);
        state[b].left.store(&f.transmittance[(static_cast<size_t>(tile) * kBlocks + b) * kLanes]);
    }
}

// Images as planes [height, width]. color [3] over the background; alpha = 1 - T; extras as blended. Null:
// not wanted.
struct OutputPlanes {
    float* color;
    float* alpha;
    float* depth;
    float* flow;
    float* stats;
};

inline void write_tile(const Frame& f, int tile, const OutputPlanes& out) {
    const int width = f.camera.width, height = f.camera.height;
    const size_t plane = static_cast<size_t>(width) * height;
    float* extra_plane[kMaxExtra] = {};
    int extra = 0;
    if (f.settings.depth) extra_plane[extra++] = out.depth;
    if (f.settings.flow) extra_plane[extra++] = out.flow, extra_plane[extra++] = out.flow + plane;
    if (f.settings.stats) extra_plane[extra++] = out.stats, extra_plane[extra++] = out.stats + plane;
    const TileSpan span = tile_span(f, tile);
    for (int b = 0; b < kBlocks; ++b) {
        const int x = span.x + b % 4 * kBlock, y = span.y + b / 4 * kBlock;
        const Float T = Float::load(&f.transmittance[(static_cast<size_t>(tile) * kBlocks + b) * kLanes]);
        auto blended = [&](int channel) { return Float::load(&f.image[block_at(f, tile, channel, b)]); };
        for (int k = 0; k < 3 && out.color; ++k)
            store_block(out.color + k * plane, width, height, x, y,
                        blended(k) + T * Float(f.settings.background[k]));
        if (out.alpha) store_block(out.alpha, width, height, x, y, Float(1.f) - T);
        for (int e = 0; e < extra; ++e) store_block(extra_plane[e], width, height, x, y, blended(3 + e));
    }
}

template <int extra>
inline void blend(Frame& f, const OutputPlanes& out) {
    StageTimer timer(f, kStageBlend);
    const int tiles = f.tiles();
    f.image.resize(static_cast<size_t>(tiles) * f.channels() * kTilePixels);
    f.transmittance.resize(static_cast<size_t>(tiles) * kTilePixels);
    f.blocks_last.resize(static_cast<size_t>(tiles) * kBlocks);
#pragma omp parallel for schedule(dynamic, 2) num_threads(f.settings.threads)
    for (int tile = 0; tile < tiles; ++tile) {
        blend_tile<extra>(f, tile);
        write_tile(f, tile, out);
    }
}

}  // namespace splat
