// Moves Gaussians along trajectories that many of them share (docs/method.md 5.1).
//
// At the time of the view, trajectory k has a displacement c_k, a rotation vector r_k and a drift c'_k, the
// mean velocity until the later time of the optical flow. A Gaussian has a weight w_k for each, and
//     (c, r, c') = Σ_k w_k (c_k, r_k, c'_k),   μ_xyz ← μ_xyz + c,   ql ← q(r) ql.
// q(r) = (cos θ/2, sin(θ/2)/θ r) turns by the angle θ = |r| about r. A Gaussian without weights stays as it
// is.
#pragma once

#include <algorithm>

#include "simd/real.hpp"
#include "simd/vec_math.hpp"
#include "simd/vec_move.hpp"
#include "types.hpp"

namespace splat {

// The weighted sums of sixteen Gaussians, and the rotation q(r).
struct SharedMotion {
    Float displacement[3], turn[3], drift[3];
    Float cosine, sine;  // cos θ/2 and sin(θ/2)/θ
    Float curvature;     // (cosine/2 - sine)/θ², with which sine changes: ∂ sine/∂r = curvature r
};

// From the series in x = (θ/2)² where θ < 1: there the quotients lose digits. Its terms end at 1e-9.
SPLAT_INLINE void half_angle(SharedMotion& m) {
    const Float angle2 = m.turn[0] * m.turn[0] + m.turn[1] * m.turn[1] + m.turn[2] * m.turn[2];
    const Mask small = angle2 < Float(1.f);
    const Float x = Float(0.25f) * min(angle2, Float(1.f));
    auto series = [&](auto... coefficients) {  // highest power first
        Float sum(0.f);
        ((sum = sum * x + Float(coefficients)), ...);
        return sum;
    };
    const Float large2 = max(angle2, Float(1.f)), angle = sqrt(large2);
    const Float turns = angle * Float(0.5f / kTwoPi);
    const Float cosine = cos_turns(turns), sine = sin_turns(turns) / angle;
    m.cosine = select(small, series(1.f / 40320, -1.f / 720, 1.f / 24, -0.5f, 1.f), cosine);
    m.sine = select(small, series(0.5f / 362880, -0.5f / 5040, 0.5f / 120, -0.5f / 6, 0.5f), sine);
    m.curvature = select(small, series(0.125f / 45360, -0.125f / 840, 0.125f / 30, -0.125f / 3),
                         (Float(0.5f) * cosine - sine) / large2);
}

// Weights `first` .. `first` + 15 of sixteen Gaussians, a Gaussian in each lane; those beyond the last are
// zero.
SPLAT_INLINE void load_weights(const Parameters& p, const uint32_t* ids, int first, Float (&weight)[kLanes]) {
    const int count = std::min(kLanes, p.trajectory_count - first);
    for (int l = 0; l < kLanes; ++l)
        weight[l] =
            Float::load_first(p.weights + static_cast<size_t>(p.trajectory_count) * ids[l] + first, count);
    transpose(weight);
}

SPLAT_INLINE SharedMotion shared_motion(const Parameters& p, const uint32_t* ids) {
    Float sum[kTrajectoryValues];
    for (Float& v : sum) v = 0.f;
    for (int first = 0; first < p.trajectory_count; first += kLanes) {
        Float weight[kLanes];
        load_weights(p, ids, first, weight);
        for (int k = first; k < std::min(first + kLanes, p.trajectory_count); ++k) {
            const scalar* trajectory = p.trajectories + kTrajectoryColumns * k;
            for (int c = 0; c < kTrajectoryValues; ++c) sum[c] += weight[k - first] * Float(trajectory[c]);
        }
    }
    SharedMotion m;
    for (int i = 0; i < 3; ++i) m.displacement[i] = sum[i], m.turn[i] = sum[3 + i], m.drift[i] = sum[6 + i];
    half_angle(m);
    return m;
}

// The Hamilton product a b of quaternions (w, x, y, z).
SPLAT_INLINE void quaternion_product(const Float (&a)[4], const Float (&b)[4], Float (&out)[4]) {
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3];
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2];
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1];
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0];
}

// ql ← q(r) ql.
SPLAT_INLINE void turn_quaternion(const SharedMotion& m, Float (&quaternion)[4]) {
    const Float turn[4] = {m.cosine, m.sine * m.turn[0], m.sine * m.turn[1], m.sine * m.turn[2]};
    const Float before[4] = {quaternion[0], quaternion[1], quaternion[2], quaternion[3]};
    quaternion_product(turn, before, quaternion);
}

}  // namespace splat
