// Layout of tiles: a 16×16 tile is sixteen 4×4 blocks, and the pixels of a block are the lanes of a Float.
#pragma once

#include <algorithm>

#include "simd/vec_move.hpp"
#include "types.hpp"

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

// Loads a row of four blocks, with its first pixel at (x, y), from an image plane [height, width]. Pixels
// outside the image are zero; all are, if plane is null.
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

// Prefetches, for writing, the cache line that each row of a tile ends in. Where a row begins inside a line,
// the tile to the left has prefetched that one. Without it stores wait for their lines and delay the next
// tile (W2: blending takes 28 instead of 20 ms).
inline void prefetch_for_writing(scalar* plane, int width, int height, int x, int y) {
    const int last = std::min(x + kTile, width) - 1;
    for (int r = y; r < std::min(y + kTile, height); ++r)
        __builtin_prefetch(plane + static_cast<size_t>(r) * width + last, 1);
}

}  // namespace splat
