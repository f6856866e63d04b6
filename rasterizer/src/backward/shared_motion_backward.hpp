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

// Adds the gradients of the first `count` Gaussians: to their rows of `weights` [N, K], and to `trajectories`
// [K, 16]. columns: [9][K], the trajectories transposed.
SPLAT_INLINE void shared_motion_backward(const Parameters& p, const uint32_t* ids, int count,
                                         const scalar* columns, const Float* d_displacement,
                                         const Float* d_turn, const Float* d_drift, scalar* weights,
                                         scalar* trajectories) {
    Float row[kLanes];
    for (Float& r : row) r = 0.f;
    for (int i = 0; i < 3; ++i) row[i] = d_displacement[i], row[3 + i] = d_turn[i], row[6 + i] = d_drift[i];
    transpose(row);
    const int trajectory_count = p.trajectory_count;
    for (int l = 0; l < count; ++l) {
        const size_t first = static_cast<size_t>(trajectory_count) * ids[l];
        const scalar* weight = p.weights + first;
        for (int k = 0; k < trajectory_count; ++k) {
            scalar* to = trajectories + kTrajectoryColumns * k;
            (Float::load(to) + Float(weight[k]) * row[l]).store(to);
        }
        alignas(64) scalar d[kLanes];
        row[l].store(d);
        scalar* d_weight = weights + first;
        for (int c = 0; c < kTrajectoryValues; ++c)
            for (int k = 0; k < trajectory_count; ++k)
                d_weight[k] += d[c] * columns[c * trajectory_count + k];
    }
}

}  // namespace splat
