// Depths of distant Gaussians in double, for the sort: there float32 cannot tell which of two is in front.
//
// A depth in double is kept as the sum of two floats.
#pragma once

#include "forward/project.hpp"

namespace splat {

// Beyond this many near planes neighbouring floats differ by 1/512 of the near plane's distance or more.
// Trained scenes are nearer, even with a background sphere. Nearer Gaussians whose float32 depths are equal
// are ordered by id.
inline constexpr scalar kDoubleDepthNearPlanes = 32768.f;

// Depths beyond this are in double.
inline scalar double_depth_from(const Settings& s) { return s.near_plane * kDoubleDepthNearPlanes; }

struct SplitDepth {
    Float high, low;
};

// Depths of sixteen Gaussians: in double of those in `lanes`, `depth` of the others.
template <Motion motion>
[[gnu::cold, gnu::noinline]] SplitDepth depths_in_double(const Stored<motion, Float>& stored, unsigned lanes,
                                                         const CameraOf<double>& camera_double,
                                                         const Float& depth) {
    SplitDepth z{depth, Float(0.f)};
    for (; lanes; lanes &= lanes - 1) {
        const int l = __builtin_ctz(lanes);
        double cam[3];
        world_to_camera<double>(camera_double.rotation, slice_in_time(stored.lane(l), camera_double).offset,
                                cam);
        set_lane(z.high, l, cam[2]);
        set_lane(z.low, l, cam[2] - static_cast<double>(static_cast<scalar>(cam[2])));
    }
    return z;
}

}  // namespace splat
