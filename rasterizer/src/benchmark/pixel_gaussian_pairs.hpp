// Counts the (pixel, Gaussian) pairs that blending evaluates, for the benchmark. No part of rendering.
#pragma once

#include "forward/blend.hpp"

namespace splat {

struct PixelGaussianPairs {
    uint64_t evaluated;     // in blocks that the splat touches and that are not done, whole blocks
    uint64_t contributing;  // those of them with a weight above zero
};

inline PixelGaussianPairs count_pairs(const ViewState& view) {
    PixelGaussianPairs pairs{0, 0};
    const Float lane_x = Float::load(kBlockPixel.x), lane_y = Float::load(kBlockPixel.y);
    for (int tile = 0; tile < view.tiles(); ++tile) {
        const TileSpan span = tile_span(view, tile);
        Float T[kBlocks];
        for (auto& t : T) t = 1.f;
        for (uint32_t e = span.begin; e < span.end; ++e) {
            const Splat& s = view.splats[view.intersection_splat[e]];
            for (unsigned blocks = view.intersection_blocks[e]; blocks; blocks &= blocks - 1) {
                const int b = __builtin_ctz(blocks);
                if (view.block_last[static_cast<size_t>(tile) * kBlocks + b] <=
                    static_cast<scalar>(e - span.begin))
                    continue;
                const Float px = lane_x + Float(static_cast<scalar>(span.x + b % 4 * kBlock));
                const Float py = lane_y + Float(static_cast<scalar>(span.y + b / 4 * kBlock));
                const Float power = log2_alpha(s, px, py);
                const Mask not_skipped = power >= Float(kLog2MinAlpha);
                const Float next =
                    T[b] * (Float(1.f) - zero_unless(not_skipped, min(exp2_fast(power), kMaxAlpha)));
                const Mask active = next >= Float(kMinTransmittance);
                T[b] = zero_unless(active, next);
                pairs.evaluated += kLanes;
                pairs.contributing += __builtin_popcount(bits(not_skipped & active));
            }
        }
    }
    return pairs;
}

}  // namespace splat
