// Everything one view's forward pass leaves for its backward pass. Reused from view to view: buffers only
// grow.
//
//     prepare → sort → bin → blend          forward, a file each
//     blend_backward → gaussian_backward    and back
#pragma once

#include <chrono>
#include <type_traits>
#include <vector>

#include "buffer.hpp"
#include "types.hpp"
#include "vec_math.hpp"

namespace splat {

inline constexpr int kChunk =
    1024;  // Gaussians prepared together: their working set stays in the second-level cache

struct Frame {
    Camera camera;
    CameraOf<double> exact_camera;  // the same, for the Gaussians that need it (exact.hpp)
    Settings settings;

    // prepare: chunk c stages its visible Gaussians at places [c·kChunk, c·kChunk + chunk_count[c]), in order
    // of id
    Buffer<Splat> staged;
    Buffer<scalar> depth;  // per place, once more: in the splats it would cost sorting a cache line each
    Buffer<scalar> depth_low;  // per place, of far Gaussians alone: what `depth` leaves over (far.hpp)
    Buffer<ColorSlope> color_slope;  // per place, if a backward pass will follow
    Buffer<scalar> extras;  // per place kExtraStride floats: depth, flow, statistics, as far as asked for
    std::vector<uint32_t> chunk_count, chunk_first;  // chunk_first: visible Gaussians before the chunk
    std::vector<uint32_t> chunk_alive;
    uint32_t visible = 0, alive = 0;

    // sort: places front to back
    using DepthBits = std::conditional_t<sizeof(scalar) == 4, uint32_t, uint64_t>;
    struct DepthKey {
        DepthBits bits;
        uint32_t place;
    };
    Buffer<DepthKey> keys[2];
    const DepthKey* front_to_back = nullptr;  // [visible], in one of the two

    // bin: entry lists of the tiles, each front to back
    int tiles_x = 0, tiles_y = 0;
    Buffer<uint32_t> tile_begin;   // [tiles + 1]
    Buffer<uint32_t> entry_splat;  // the splat's place
    Buffer<uint16_t> entry_mask;   // which of the tile's 4×4 blocks it touches
    Buffer<uint32_t> entry_slot;   // where its gradient goes
    struct SlotRange {
        uint32_t begin, count;
    };
    Buffer<SlotRange> slot_range;  // per place
    struct Segment {               // one thread's share of the sorted splats
        std::vector<uint32_t> tile_count;
        // of each entry; both longer than there are entries, so that they are never cleared
        std::vector<uint32_t> tile;
        std::vector<uint16_t> mask;
    };
    std::vector<Segment> segments;

    Buffer<scalar> blocks_last;  // blend: [tile][block] entries that had any effect; exact up to 2²⁴
    Buffer<Slot> slots;          // blend_backward: [entry_slot]

    double stage_ms[8] = {};  // wall time of the stages below

    int tiles() const { return tiles_x * tiles_y; }
};

inline constexpr int kExtraStride = 8;
enum Stage { kStagePrepare, kStageSort, kStageBin, kStageBlend, kStageBlendBackward, kStageGaussianBackward };

class StageTimer {
public:
    StageTimer(Frame& frame, Stage stage) : slot_(frame.stage_ms[stage]), start_(Clock::now()) {}
    ~StageTimer() { slot_ = std::chrono::duration<double, std::milli>(Clock::now() - start_).count(); }

private:
    using Clock = std::chrono::steady_clock;
    double& slot_;
    Clock::time_point start_;
};

// How far a pixel lies from the ellipse's leaning axis, along its row.
SPLAT_INLINE Float across_of(const Splat& s, const Float& px, const Float& py) {
    return (px - Float(s.intercept)) + py * Float(s.lean);
}
// log2 of alpha before its cap, at a pixel.
SPLAT_INLINE Float log2_alpha_of(const Splat& s, const Float& across, const Float& along) {
    return across * (across * Float(s.across)) + (along * along * Float(s.along) + Float(s.log2_opacity));
}
SPLAT_INLINE Float log2_alpha(const Splat& s, const Float& px, const Float& py) {
    return log2_alpha_of(s, across_of(s, px, py), py - Float(s.y));
}

}  // namespace splat
