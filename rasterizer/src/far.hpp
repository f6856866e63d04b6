// How far away a Gaussian is, where float32 no longer says which of two lies in front: z in double by the
// same code, kept as a float and, like the camera's centre, a second float for what the first cannot hold.
#pragma once

#include "look.hpp"

namespace splat {

// Beyond so many near planes float32 steps by 1/512 of the near plane's distance or more. Scenes as trained
// lie nearer, a background sphere thousands of near planes away too; there what ties in float32 is ordered by
// ids.
inline constexpr scalar kFarNearPlanes = 32768.f;

inline scalar far_depth(const Settings& s) { return s.near_plane * kFarNearPlanes; }

struct Depths {
    Float high, low;
};

// Of sixteen Gaussians, those in `far` in double; the others' is `depth`.
template <Motion motion>
[[gnu::cold, gnu::noinline]] Depths far_depths(const Stored<motion, Float>& stored, unsigned far,
                                               const CameraOf<double>& exact, const Float& depth) {
    Depths z{depth, Float(0.f)};
    for (; far; far &= far - 1) {
        const int l = __builtin_ctz(far);
        double cam[3];
        world_to_camera<double>(exact, slice_in_time(stored.lane(l), exact).offset, cam);
        set_lane(z.high, l, cam[2]);
        set_lane(z.low, l, cam[2] - static_cast<double>(static_cast<scalar>(cam[2])));
    }
    return z;
}

}  // namespace splat
