// How many (pixel, Gaussian) pairs blending looks at, and how many of them count. For the benchmark: not on
// any frame's path.
#pragma once

#include "blend.hpp"

namespace splat {

struct Pairs {
    uint64_t evaluated;     // lanes of the blocks that an entry's mask names and that have not ended
    uint64_t contributing;  // of these, with a weight above zero
};

inline Pairs count_pairs(const Frame& f) {
    Pairs pairs{0, 0};
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    for (int tile = 0; tile < f.tiles(); ++tile) {
        const TileSpan span = tile_span(f, tile);
        Float T[kBlocks];
        for (auto& t : T) t = 1.f;
        for (uint32_t e = span.begin; e < span.end; ++e) {
            const Splat& s = f.staged[f.entry_splat[e]];
            for (unsigned blocks = f.entry_mask[e]; blocks; blocks &= blocks - 1) {
                const int b = __builtin_ctz(blocks);
                if (f.blocks_last[static_cast<size_t>(tile) * kBlocks + b] <=
                    static_cast<scalar>(e - span.begin))
                    continue;
                const Float px = lane_x + Float(static_cast<scalar>(span.x + b % 4 * kBlock));
                const Float py = lane_y + Float(static_cast<scalar>(span.y + b / 4 * kBlock));
                const Float power = log2_alpha(s, px, py);
                const Mask seen = power >= Float(kLog2MinAlpha);
                const Float next = T[b] * (Float(1.f) - zero_unless(seen, min(exp2_fast(power), kMaxAlpha)));
                const Mask live = next >= Float(kMinTransmittance);
                T[b] = zero_unless(live, next);
                pairs.evaluated += kLanes;
                pairs.contributing += __builtin_popcount(bits(seen & live));
            }
        }
    }
    return pairs;
}

}  // namespace splat
