// Stage 3, tile intersection: for each 16×16 tile the splats that touch it, front to back, with a mask of the
// 4×4 blocks that they touch.
//
// The test is exact: a block counts only where alpha reaches 1/255 somewhere in it, which leaves a third to a
// quarter of the pixels of the bounding box. The splats come sorted, so a stable counting sort by tile keeps
// each tile's list front to back, and intersections need no depth sort.
#pragma once

#include <algorithm>
#include <cstdint>
#include <exception>
#include <stdexcept>
#include <utility>
#include <vector>

#include "forward/tile.hpp"
#include "view_state.hpp"

namespace splat {

// Positions in the tiles' lists have 32 bits, and blend's counter goes up to 256 beyond the last.
inline constexpr size_t kMaxIntersections = 4294967000;

// Bit b: the largest alpha over the pixel centres' square of block b is at least 1/255.
// ln alpha is concave, so its maximum over a rectangle is on a side facing the mean: the best point of the
// nearest column or that of the nearest row. With dx, dy from the mean, k the shear, and K = k² conic_u +
// conic_v, the square of Splat is completed in dy for the column:
//     conic_u (dx + k dy)² + conic_v dy² = conic_u conic_v / K dx² + K (dy + k conic_u / K dx)².
SPLAT_INLINE unsigned blocks_in_ellipse(const Splat& s, scalar tile_x, scalar tile_y) {
    const scalar shear_conic_u = s.shear * s.conic_u, curvature = shear_conic_u * s.shear + s.conic_v,
                 slope = shear_conic_u / curvature, conic_x = s.conic_v * (s.conic_u / curvature);
    const Float x0 = Float::load(kBlockCorner.x) + Float(tile_x - s.x),
                y0 = Float::load(kBlockCorner.y) + Float(tile_y - s.y);
    const Float x1 = x0 + Float(kBlock - 1.f), y1 = y0 + Float(kBlock - 1.f);
    const Float dx = clamp(0.f, x0, x1), dy = clamp(0.f, y0, y1);
    const Float slope_dx = Float(slope) * dx, shear_dy = Float(s.shear) * dy;
    const Float off_y = clamp(-slope_dx, y0, y1) + slope_dx, off_x = clamp(-shear_dy, x0, x1) + shear_dy;
    const Float largest = max(dx * dx * Float(conic_x) + off_y * off_y * Float(curvature),
                              dy * dy * Float(s.conic_v) + off_x * off_x * Float(s.conic_u));
    return bits(largest >= Float(kLog2MinAlpha - s.log2_opacity));
}

// Bit b: the bounding box of the alpha >= 1/255 ellipse touches block b's pixel centres.
SPLAT_INLINE unsigned blocks_in_box(const Splat& s, scalar tile_x, scalar tile_y) {
    const Float x0 = Float::load(kBlockCorner.x) + Float(tile_x - s.x),
                y0 = Float::load(kBlockCorner.y) + Float(tile_y - s.y);
    return bits((x0 <= Float(s.half_width)) & (x0 + Float(kBlock - 1.f) >= Float(-s.half_width)) &
                (y0 <= Float(s.half_height)) & (y0 + Float(kBlock - 1.f) >= Float(-s.half_height)));
}

// The blocks to blend a splat into, a bit each; none if it does not touch the tile.
SPLAT_INLINE unsigned touched_blocks(const Splat& s, scalar tile_x, scalar tile_y) {
    const unsigned touched =
        kExactCulling ? blocks_in_ellipse(s, tile_x, tile_y) : blocks_in_box(s, tile_x, tile_y);
    return kBlockMasks || !touched ? touched : 0xffff;
}

struct TileRect {
    int x0, x1, y0, y1;  // inclusive
};
inline TileRect tiles_of_box(const ViewState& view, const Splat& s) {
    auto tile = [](scalar v, int tiles) {  // clamped as a float: a huge box does not fit an int
        return static_cast<int>(std::clamp(v * (1.f / kTile), scalar{0}, static_cast<scalar>(tiles - 1)));
    };
    return {tile(s.x - s.half_width, view.tiles_x), tile(s.x + s.half_width, view.tiles_x),
            tile(s.y - s.half_height, view.tiles_y), tile(s.y + s.half_height, view.tiles_y)};
}

inline constexpr size_t kPrefetchDistance = 16;  // splats ahead: depth order is not memory order

inline void intersect_tiles(ViewState& view) {
    StageTimer timer(view, kStageIntersectTiles);
    view.tiles_x = (view.camera.width + kTile - 1) / kTile;
    view.tiles_y = (view.camera.height + kTile - 1) / kTile;
    const int tiles = view.tiles(), threads = view.settings.threads;
    const size_t n = view.visible, capacity = view.chunk_count.size() * kChunk;
    view.thread_intersections.resize(threads);
    view.gradient_range.resize(capacity);
    auto thread_begin = [&](int t) { return n * t / threads; };

    // Each thread lists (tile, mask) of its share of the splats. The result does not depend on the shares.
    std::exception_ptr failed;  // for lack of memory: no exception may leave the region
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int t = 0; t < threads; ++t) {
        try {
            ViewState::ThreadIntersections& list = view.thread_intersections[t];
            list.tile_count.assign(tiles, 0);
            size_t n_intersections = 0;
            for (size_t i = thread_begin(t); i < thread_begin(t + 1); ++i) {
                const uint32_t splat_index = view.front_to_back[i].splat_index;
                if (i + kPrefetchDistance < n) {
                    const uint32_t ahead = view.front_to_back[i + kPrefetchDistance].splat_index;
                    __builtin_prefetch(&view.splats[ahead]);
                    __builtin_prefetch(&view.gradient_range[ahead], 1);
                }
                const Splat& splat = view.splats[splat_index];
                const TileRect range = tiles_of_box(view, splat);
                const size_t needed = n_intersections + static_cast<size_t>(range.x1 - range.x0 + 1) *
                                                            (range.y1 - range.y0 + 1);
                if (needed > list.tile.size()) {
                    list.tile.resize(needed + needed / 2 + 1024);
                    list.mask.resize(list.tile.size());
                }
                const size_t before = n_intersections;
                for (int y = range.y0; y <= range.y1; ++y)
                    for (int x = range.x0; x <= range.x1; ++x) {
                        const unsigned mask = touched_blocks(splat, static_cast<scalar>(x * kTile),
                                                             static_cast<scalar>(y * kTile));
                        const uint32_t tile = static_cast<uint32_t>(y * view.tiles_x + x),
                                       touched = mask != 0;
                        // Overwritten by the next unless touched: a branch would be mispredicted often.
                        list.tile[n_intersections] = tile;
                        list.mask[n_intersections] = static_cast<uint16_t>(mask);
                        list.tile_count[tile] += touched;
                        n_intersections += touched;
                    }
                view.gradient_range[splat_index].count = static_cast<uint32_t>(n_intersections - before);
            }
        } catch (...) {
#pragma omp critical
            failed = std::current_exception();
        }
    }

    if (failed) std::rethrow_exception(failed);
    size_t all = 0;
    for (const auto& list : view.thread_intersections)
        for (uint32_t count : list.tile_count) all += count;
    if (all > kMaxIntersections)
        throw std::length_error("more than 4294967000 intersections of Gaussians with tiles");

    // Where each tile's list begins, and in it each thread's part.
    view.tile_begin.resize(tiles + 1);
    uint32_t total = 0;
    for (int t = 0; t < tiles; ++t) {
        view.tile_begin[t] = total;
        for (auto& list : view.thread_intersections) total += std::exchange(list.tile_count[t], total);
    }
    view.tile_begin[tiles] = total;
    // The intersection gradients of one splat are contiguous, splats in order of id: preprocess_backward
    // reads them in sequence.
    const int chunks = static_cast<int>(view.chunk_count.size());
    std::vector<uint32_t> chunk_gradients(chunks, 0);  // of each chunk; then of all chunks before it
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int c = 0; c < chunks; ++c)
        for (uint32_t i = 0; i < view.chunk_count[c]; ++i)
            chunk_gradients[c] += view.gradient_range[static_cast<size_t>(c) * kChunk + i].count;
    uint32_t n_gradients = 0;
    for (uint32_t& first : chunk_gradients) n_gradients += std::exchange(first, n_gradients);
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int c = 0; c < chunks; ++c) {
        uint32_t next = chunk_gradients[c];
        for (uint32_t i = 0; i < view.chunk_count[c]; ++i) {
            ViewState::GradientRange& range = view.gradient_range[static_cast<size_t>(c) * kChunk + i];
            range.begin = next;
            next += range.count;
        }
    }

    view.intersection_splat.resize(total + kLanes);  // blend reads sixteen at a time
    view.intersection_blocks.resize(total + kLanes);
    view.gradient_index.resize(total);
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int t = 0; t < threads; ++t) {
        ViewState::ThreadIntersections& list = view.thread_intersections[t];
        size_t e = 0;
        for (size_t i = thread_begin(t); i < thread_begin(t + 1); ++i) {
            const uint32_t splat_index = view.front_to_back[i].splat_index;
            if (i + kPrefetchDistance < n)
                __builtin_prefetch(
                    &view.gradient_range[view.front_to_back[i + kPrefetchDistance].splat_index]);
            const ViewState::GradientRange gradients = view.gradient_range[splat_index];
            for (uint32_t k = 0; k < gradients.count; ++k, ++e) {
                const uint32_t to = list.tile_count[list.tile[e]]++;
                view.intersection_splat[to] = splat_index;
                view.intersection_blocks[to] = list.mask[e];
                view.gradient_index[to] = gradients.begin + k;
            }
        }
    }
}

}  // namespace splat
