// The geometry of tiles: a 16×16 tile is sixteen 4×4 blocks, a block's pixels are the lanes of a Float.
#pragma once

#include "types.hpp"
#include "vec.hpp"

namespace splat {

inline constexpr struct BlockCorners {
    alignas(64) float x[16], y[16];  // first pixel of each block within its tile
    constexpr BlockCorners() : x{}, y{} {
        for (int b = 0; b < kBlocks; ++b)
            x[b] = static_cast<float>(b % 4 * kBlock), y[b] = static_cast<float>(b / 4 * kBlock);
    }
} kBlockCorner;

inline constexpr struct BlockPixels {
    alignas(64) float x[16], y[16];  // each lane's pixel within its block: lane = 4 row + column
    constexpr BlockPixels() : x{}, y{} {
        for (int l = 0; l < kLanes; ++l)
            x[l] = static_cast<float>(l % kBlock), y[l] = static_cast<float>(l / kBlock);
    }
} kBlockPixel;

// A 4×4 block of an image plane [height, width] at (x, y); pixels outside read as zero.
inline Float load_block(const float* plane, int width, int height, int x, int y) {
    alignas(64) float lane[16] = {};
    const float* from = plane + static_cast<size_t>(y) * width + x;
    if (x + kBlock <= width && y + kBlock <= height) {
        for (int r = 0; r < kBlock; ++r)
            std::memcpy(lane + kBlock * r, from + static_cast<size_t>(r) * width, sizeof(Quad));
    } else {
        for (int r = 0; r < kBlock && y + r < height; ++r)
            for (int c = 0; c < kBlock && x + c < width; ++c)
                lane[kBlock * r + c] = from[static_cast<size_t>(r) * width + c];
    }
    return Float::load(lane);
}
inline void store_block(float* plane, int width, int height, int x, int y, const Float& value) {
    alignas(64) float lane[16];
    value.store(lane);
    float* to = plane + static_cast<size_t>(y) * width + x;
    if (x + kBlock <= width && y + kBlock <= height) {
        for (int r = 0; r < kBlock; ++r)
            std::memcpy(to + static_cast<size_t>(r) * width, lane + kBlock * r, sizeof(Quad));
    } else {
        for (int r = 0; r < kBlock && y + r < height; ++r)
            for (int c = 0; c < kBlock && x + c < width; ++c)
                to[static_cast<size_t>(r) * width + c] = lane[kBlock * r + c];
    }
}

}  // namespace splat
