// Stage 3: for each 16×16 tile the Gaussians that touch it, front to back, and which of its 4×4 blocks they
// touch.
//
// Exact: an entry is made, and a block marked, only where alpha reaches 1/255 somewhere in it (3 to 4 times
// fewer pixels than the bounding rectangle). The splats come sorted, so a stable counting scatter keeps each
// tile's list front to back without sorting entries.
#pragma once

#include <algorithm>
#include <utility>
#include <vector>

#include "blocks.hpp"
#include "frame.hpp"

namespace splat {

// Bit b: the largest alpha over the pixel centres' square of block b is at least 1/255.
// ln alpha is concave, so over a rectangle it is largest on the side facing the mean: try the nearest column
// and the nearest row, each at its best point.
SPLAT_INLINE unsigned blocks_under_ellipse(const Splat& s, scalar tile_x, scalar tile_y) {
    const Float x0 = Float::load(kBlockCorner.x) + Float(tile_x),
                y0 = Float::load(kBlockCorner.y) + Float(tile_y);
    const Float x1 = x0 + Float(kBlock - 1.f), y1 = y0 + Float(kBlock - 1.f);
    const Float px = clamp(s.x, x0, x1), py = clamp(s.y, y0, y1);
    // On column px: across k (px - x₀ + k py) + along (py - y) = 0. On row py: px - x₀ + k py = 0.
    const scalar lean_across = s.lean * s.across, inverse = 1.f / (lean_across * s.lean + s.along);
    const Float start = px - Float(s.intercept);
    const Float y_best = clamp((Float(s.along * s.y) - start * Float(lean_across)) * Float(inverse), y0, y1),
                x_best = clamp(Float(s.intercept) - py * Float(s.lean), x0, x1);
    const Float most = max(log2_alpha(s, px, y_best), log2_alpha(s, x_best, py));
    return bits(most >= Float(kLog2MinAlpha));
}

// Bit b: the rectangle round the alpha >= 1/255 ellipse touches block b's pixel centres.
SPLAT_INLINE unsigned blocks_under_rectangle(const Splat& s, scalar tile_x, scalar tile_y) {
    const Float x0 = Float::load(kBlockCorner.x) + Float(tile_x - s.x),
                y0 = Float::load(kBlockCorner.y) + Float(tile_y - s.y);
    return bits((x0 <= Float(s.half_width)) & (x0 + Float(kBlock - 1.f) >= Float(-s.half_width)) &
                (y0 <= Float(s.half_height)) & (y0 + Float(kBlock - 1.f) >= Float(-s.half_height)));
}

// The blocks to blend a splat into: a bit each, none if it does not touch the tile.
SPLAT_INLINE unsigned touched_blocks(const Splat& s, scalar tile_x, scalar tile_y) {
    const unsigned touched =
        kExactCulling ? blocks_under_ellipse(s, tile_x, tile_y) : blocks_under_rectangle(s, tile_x, tile_y);
    return kBlockMasks || !touched ? touched : 0xffff;
}

struct TileRange {
    int x0, x1, y0, y1;  // inclusive
};
inline TileRange tiles_under(const Frame& f, const Splat& s) {
    auto tile = [](scalar v, int tiles) {  // clamped as a float: a huge extent does not fit an int
        return static_cast<int>(std::clamp(v * (1.f / kTile), scalar{0}, static_cast<scalar>(tiles - 1)));
    };
    return {tile(s.x - s.half_width, f.tiles_x), tile(s.x + s.half_width, f.tiles_x),
            tile(s.y - s.half_height, f.tiles_y), tile(s.y + s.half_height, f.tiles_y)};
}

inline constexpr size_t kAhead = 16;  // splats fetched ahead: depth order is no order in memory

inline void bin(Frame& f) {
    StageTimer timer(f, kStageBin);
    f.tiles_x = (f.camera.width + kTile - 1) / kTile;
    f.tiles_y = (f.camera.height + kTile - 1) / kTile;
    const int tiles = f.tiles(), segments = f.settings.threads;
    const size_t n = f.visible, places = f.chunk_count.size() * kChunk;
    f.segments.resize(segments);
    f.slot_range.resize(places);
    auto segment_begin = [&](int s) { return n * s / segments; };

    // List (tile, mask) splat by splat. How the splats are divided among threads does not show in the result.
#pragma omp parallel for schedule(static, 1) num_threads(segments)
    for (int s = 0; s < segments; ++s) {
        Frame::Segment& list = f.segments[s];
        list.tile_count.assign(tiles, 0);
        size_t n_entries = 0;
        for (size_t i = segment_begin(s); i < segment_begin(s + 1); ++i) {
            const uint32_t place = f.front_to_back[i].place;
            if (i + kAhead < n) __builtin_prefetch(&f.staged[f.front_to_back[i + kAhead].place]);
            const Splat& splat = f.staged[place];
            const TileRange range = tiles_under(f, splat);
            const size_t most =
                n_entries + static_cast<size_t>(range.x1 - range.x0 + 1) * (range.y1 - range.y0 + 1);
            if (most > list.tile.size()) {
                list.tile.resize(most + most / 2 + 1024);
                list.mask.resize(list.tile.size());
            }
            const size_t before = n_entries;
            for (int y = range.y0; y <= range.y1; ++y)
                for (int x = range.x0; x <= range.x1; ++x) {
                    const unsigned mask =
                        touched_blocks(splat, static_cast<scalar>(x * kTile), static_cast<scalar>(y * kTile));
                    const uint32_t tile = static_cast<uint32_t>(y * f.tiles_x + x), touched = mask != 0;
                    list.tile[n_entries] = tile;  // kept only if touched; a branch here would be a coin toss
                    list.mask[n_entries] = static_cast<uint16_t>(mask);
                    list.tile_count[tile] += touched;
                    n_entries += touched;
                }
            f.slot_range[place].count = static_cast<uint32_t>(n_entries - before);
        }
    }

    // Where each tile's list begins, and each segment's part of it.
    f.tile_begin.resize(tiles + 1);
    uint32_t total = 0;
    for (int t = 0; t < tiles; ++t) {
        f.tile_begin[t] = total;
        for (auto& list : f.segments) total += std::exchange(list.tile_count[t], total);
    }
    f.tile_begin[tiles] = total;
    // Gradient slots of one Gaussian lie together, Gaussians in order of id: the reduction reads them in
    // sequence.
    const int chunks = static_cast<int>(f.chunk_count.size());
    std::vector<uint32_t> chunk_slot(chunks, 0);  // entries of the chunk, then its first slot
#pragma omp parallel for schedule(static) num_threads(segments)
    for (int c = 0; c < chunks; ++c)
        for (uint32_t i = 0; i < f.chunk_count[c]; ++i)
            chunk_slot[c] += f.slot_range[static_cast<size_t>(c) * kChunk + i].count;
    uint32_t slots = 0;
    for (uint32_t& first : chunk_slot) slots += std::exchange(first, slots);
#pragma omp parallel for schedule(static) num_threads(segments)
    for (int c = 0; c < chunks; ++c) {
        uint32_t slot = chunk_slot[c];
        for (uint32_t i = 0; i < f.chunk_count[c]; ++i) {
            Frame::SlotRange& range = f.slot_range[static_cast<size_t>(c) * kChunk + i];
            range.begin = slot;
            slot += range.count;
        }
    }

    f.entry_splat.resize(total + kLanes);  // blend reads masks and indices sixteen at a time
    f.entry_mask.resize(total + kLanes);
    f.entry_slot.resize(total);
#pragma omp parallel for schedule(static, 1) num_threads(segments)
    for (int s = 0; s < segments; ++s) {
        Frame::Segment& list = f.segments[s];
        size_t e = 0;
        for (size_t i = segment_begin(s); i < segment_begin(s + 1); ++i) {
            const uint32_t place = f.front_to_back[i].place;
            const Frame::SlotRange slots = f.slot_range[place];
            for (uint32_t k = 0; k < slots.count; ++k, ++e) {
                const uint32_t to = list.tile_count[list.tile[e]]++;
                f.entry_splat[to] = place;
                f.entry_mask[to] = list.mask[e];
                f.entry_slot[to] = slots.begin + k;
            }
        }
    }
}

}  // namespace splat
