// What one view's stages leave for each other, forward and backward (see render.hpp for the stages).
//
// Reused from view to view: buffers only grow.
#pragma once

#include <chrono>
#include <type_traits>
#include <vector>

#include "buffer.hpp"
#include "simd/vec_math.hpp"
#include "types.hpp"

namespace splat {

// Gaussians preprocessed together by one thread: their working set stays in the second-level cache.
inline constexpr int kChunk = 256;

struct ViewState {
    Camera camera;
    CameraOf<double> camera_double;  // the same camera, for Gaussians that need double precision
    Settings settings;

    // preprocess: chunk c writes its visible splats, in order of id, at indices [c·kChunk, c·kChunk +
    // chunk_count[c]). Buffers below are indexed likewise.
    Buffer<Splat> splats;
    Buffer<scalar> depth;      // a copy: reading it from the splats would cost the sort a cache line each
    Buffer<scalar> depth_low;  // rest of a distant splat's depth, which float32 lacks (depth_in_double.hpp)
    Buffer<ColorJacobian> color_jacobian;  // only if a backward pass will follow
    Buffer<scalar> extras;                 // kExtraStride a splat: depth, flow, statistics
    std::vector<uint32_t> chunk_count;     // visible splats of each chunk
    std::vector<uint32_t> chunk_first;     // visible splats of the chunks before it
    std::vector<uint32_t> chunk_alive;
    uint32_t visible = 0;  // Gaussians on the screen
    uint32_t alive = 0;    // Gaussians with p(t) >= 0.05

    // sort: splat indices front to back
    using DepthBits = std::conditional_t<sizeof(scalar) == 4, uint32_t, uint64_t>;
    struct DepthKey {
        DepthBits bits;
        uint32_t splat_index;
    };
    Buffer<DepthKey> keys[2];
    const DepthKey* front_to_back = nullptr;  // [visible], in one of the two

    // intersect_tiles: the intersections of each tile, front to back
    int tiles_x = 0, tiles_y = 0;
    Buffer<uint32_t> tile_begin;           // [tiles + 1]
    Buffer<uint32_t> intersection_splat;   // index into splats
    Buffer<uint16_t> intersection_blocks;  // a bit for each 4×4 block of the tile that it touches
    Buffer<uint32_t> gradient_index;       // index into intersection_gradients
    struct GradientRange {
        uint32_t begin, count;
    };
    Buffer<GradientRange> gradient_range;  // per splat: its part of intersection_gradients
    struct ThreadIntersections {           // one thread's share of the sorted splats
        std::vector<uint32_t> tile_count;
        // Per intersection. Both are longer than needed, so that they are never cleared.
        std::vector<uint32_t> tile;
        std::vector<uint16_t> mask;
    };
    std::vector<ThreadIntersections> thread_intersections;

    // blend: [tile][block] how many of the tile's intersections the block needed; as a float exact up to 2²⁴
    Buffer<scalar> block_last;
    Buffer<IntersectionGradient> intersection_gradients;  // blend_backward

    double stage_ms[8] = {};  // wall time by Stage

    int tiles() const { return tiles_x * tiles_y; }
};

inline constexpr int kExtraStride = 8;
enum Stage {
    kStagePreprocess,
    kStageSort,
    kStageIntersectTiles,
    kStageBlend,
    kStageBlendBackward,
    kStagePreprocessBackward
};

class StageTimer {
public:
    StageTimer(ViewState& view, Stage stage) : ms_(view.stage_ms[stage]), start_(Clock::now()) {}
    ~StageTimer() { ms_ = std::chrono::duration<double, std::milli>(Clock::now() - start_).count(); }

private:
    using Clock = std::chrono::steady_clock;
    double& ms_;
    Clock::time_point start_;
};

// u of a pixel: the sheared horizontal distance to the mean (Splat).
SPLAT_INLINE Float sheared_dx(const Splat& s, const Float& px, const Float& py) {
    return (px - Float(s.sheared_x)) + py * Float(s.shear);
}
// log2 of alpha at (u, v), before alpha is clamped to 0.99.
SPLAT_INLINE Float log2_alpha_at(const Splat& s, const Float& u, const Float& v) {
    return u * (u * Float(s.conic_u)) + (v * v * Float(s.conic_v) + Float(s.log2_opacity));
}
// The same at a pixel.
SPLAT_INLINE Float log2_alpha(const Splat& s, const Float& px, const Float& py) {
    return log2_alpha_at(s, sheared_dx(s, px, py), py - Float(s.y));
}

}  // namespace splat
