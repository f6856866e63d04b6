// The geometry of tiles: a 16×16 tile is sixteen 4×4 blocks, a block's pixels are the lanes of a Float.
#pragma once

#include <algorithm>

#include "types.hpp"
#include "vec_move.hpp"

namespace splat {

inline constexpr struct BlockCorners {
    alignas(64) scalar x[16], y[16];  // first pixel of each block within its tile
    constexpr BlockCorners() : x{}, y{} {
        for (int b = 0; b < kBlocks; ++b)
            x[b] = static_cast<scalar>(b % 4 * kBlock), y[b] = static_cast<scalar>(b / 4 * kBlock);
    }
} kBlockCorner;

inline constexpr struct BlockPixels {
    alignas(64) scalar x[16], y[16];  // each lane's pixel within its block: lane = 4 row + column
    constexpr BlockPixels() : x{}, y{} {
        for (int l = 0; l < kLanes; ++l)
            x[l] = static_cast<scalar>(l % kBlock), y[l] = static_cast<scalar>(l / kBlock);
    }
} kBlockPixel;

// Four blocks side by side, the first with its first pixel at (x, y), from an image plane [height, width];
// pixels outside read as zero. Null: all zero.
inline void load_blocks(const scalar* plane, int width, int height, int x, int y, Float (&block)[kBlock]) {
    for (auto& b : block) b = 0.f;
    if (!plane) return;
    const int columns = std::clamp(width - x, 0, kTile);
    for (int r = 0; r < std::min(kBlock, height - y); ++r)
        block[r] = Float::load_first(plane + static_cast<size_t>(y + r) * width + x, columns);
    transpose_of_quads(block);
}
inline void store_blocks(scalar* plane, int width, int height, int x, int y, Float (&block)[kBlock]) {
    transpose_of_quads(block);
    const int columns = std::clamp(width - x, 0, kTile);
    for (int r = 0; r < std::min(kBlock, height - y); ++r)
        block[r].store_first(plane + static_cast<size_t>(y + r) * width + x, columns);
}

// Fetches the lines that a tile's rows end in, to be written; where a row begins in the middle of a line, the
// tile to the left has fetched it. Stores that wait for their lines hold up the next tile (W2: 28 ms of
// blending → 20).
inline void prefetch_for_writing(scalar* plane, int width, int height, int x, int y) {
    const int last = std::min(x + kTile, width) - 1;
    for (int r = y; r < std::min(y + kTile, height); ++r)
        __builtin_prefetch(plane + static_cast<size_t>(r) * width + last, 1);
}

}  // namespace splat
