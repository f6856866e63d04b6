// Backward of forward/shared_motion.hpp: from the gradients of moved Gaussians to those of their weights, of
// the trajectories, and of the quaternions before.
#pragma once

#include "forward/shared_motion.hpp"

namespace splat {

// ∂L/∂r and ∂L/∂ql from d = ∂L/∂(q(r) ql), which becomes ∂L/∂ql. before: ql.
SPLAT_INLINE void turn_quaternion_backward(const SharedMotion& m, const Float (&before)[4], Float (&d)[4],
                                           Float (&d_turn)[3]) {
    const Float turned_back[4] = {m.cosine, -(m.sine * m.turn[0]), -(m.sine * m.turn[1]),
                                  -(m.sine * m.turn[2])};
    const Float conjugate[4] = {before[0], -before[1], -before[2], -before[3]};
    const Float d_moved[4] = {d[0], d[1], d[2], d[3]};
    Float d_q[4];
    quaternion_product(d_moved, conjugate, d_q);
    quaternion_product(turned_back, d_moved, d);
    const Float along = d_q[1] * m.turn[0] + d_q[2] * m.turn[1] + d_q[3] * m.turn[2];
    const Float common = m.curvature * along - Float(0.5f) * m.sine * d_q[0];  // ∂ cos(θ/2)/∂r = -½ sine r
    for (int i = 0; i < 3; ++i) d_turn[i] = m.sine * d_q[1 + i] + common * m.turn[i];
}

// The trajectories of a view transposed, and the sums of a chunk's gradients by them:
// [kTrajectoryValues][stride].
inline int trajectory_stride(const Parameters& p) {
    return (p.trajectory_count + kLanes - 1) / kLanes * kLanes;
}

// Adds the gradients of the first `count` Gaussians: to their rows of `weights` [N, K], and to
// `d_trajectories`. d: by displacement, rotation vector and, in a view with optical flow, drift.
SPLAT_INLINE void shared_motion_backward(const Parameters& p, const uint32_t* ids, int count, bool flow,
                                         const scalar* trajectories, const Float (&d)[kTrajectoryValues],
                                         scalar* weights, scalar* d_trajectories) {
    const int stride = trajectory_stride(p), values = flow ? kTrajectoryValues : 6;
    alignas(64) scalar lane[kTrajectoryValues][kLanes];
    for (int c = 0; c < values; ++c) d[c].store(lane[c]);
    for (int first = 0; first < p.trajectory_count; first += kLanes) {
        const int n = std::min(kLanes, p.trajectory_count - first);
        auto row = [&](int l) { return static_cast<size_t>(p.trajectory_count) * ids[l] + first; };
        for (int c = 0; c < values; c += 3) {
            scalar* to = d_trajectories + c * stride + first;
            Float sum[3] = {Float::load(to), Float::load(to + stride), Float::load(to + 2 * stride)};
            for (int l = 0; l < count; ++l) {
                const Float weight = Float::load_first(p.weights + row(l), n);
                for (int i = 0; i < 3; ++i) sum[i] += weight * Float(lane[c + i][l]);
            }
            for (int i = 0; i < 3; ++i) sum[i].store(to + i * stride);
        }
        for (int l = 0; l < count; ++l) {
            Float sum = Float::load_first(weights + row(l), n);
            for (int c = 0; c < values; ++c)
                sum += Float(lane[c][l]) * Float::load(trajectories + c * stride + first);
            sum.store_first(weights + row(l), n);
        }
    }
}

}  // namespace splat
