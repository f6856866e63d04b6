// Slices 4D Gaussians at time t: the conditional 3D Gaussian and the temporal marginal (paper, section 3.2).
//
// Sixteen Gaussians at a time, one in each lane. M = R diag(s), Σ = M Mᵀ. With m_t the time row of M:
//     Σtt = |m_t|²,   h = Σ_xyz,t / Σtt,   μ(t) = μ_xyz + h (t - μt),   Σ(t) = A Aᵀ,   A = M_xyz - h m_tᵀ.
// Equivalently A = M_xyz (I - v vᵀ) with v = m_t/|m_t|. The textbook form Σ_xyz - Σ_xyz,t Σ_t,xyz / Σtt
// suffers from cancellation in float32. p may be that of a later time, t + marginal_offset: training moves
// Gaussians along their paths with it. Without 4D rotation, A = R diag(s) of space, Σtt = st², and h is
// stored.
#pragma once

#include "forward/quaternion.hpp"
#include "forward/shared_motion.hpp"

namespace splat {

// Columns of M that count: the axes of the ellipsoid.
template <Motion motion>
inline constexpr int kAxes = motion == Motion::kFull ? 4 : 3;

// Whether the motion has a velocity.
template <Motion motion>
inline constexpr bool kMoves = motion != Motion::kStatic;

// The stored parameters of sixteen Gaussians, or of one in double, moved along the shared trajectories.
template <Motion motion, class Real>
struct Stored {
    Real mean[4], log_scale[4], quat_left[4], quat_right[4], velocity[3], opacity_logit;
    Real drift[3];  // of separable motion: what the shared trajectories add to the velocity of the flow

    // moved: how the shared trajectories move them, on request.
    SPLAT_INLINE static Stored load(const Parameters& p, const uint32_t* ids, SharedMotion* moved = nullptr) {
        Stored s;
        auto gather = [&](const scalar* base, int stride, int column) {
            alignas(64) scalar lane[kLanes];
            for (int l = 0; l < kLanes; ++l) lane[l] = base[static_cast<size_t>(stride) * ids[l] + column];
            return Float::load(lane);
        };
        if constexpr (motion == Motion::kStatic) {
            for (int i = 0; i < 3; ++i)
                s.mean[i] = gather(p.mean, 3, i), s.log_scale[i] = gather(p.log_scale, 3, i);
        } else {
            load_rows4(p.mean, ids, s.mean);
            load_rows4(p.log_scale, ids, s.log_scale);
        }
        load_rows4(p.quat_left, ids, s.quat_left);
        if constexpr (motion == Motion::kFull) load_rows4(p.quat_right, ids, s.quat_right);
        if constexpr (motion == Motion::kSeparable) {
            for (int i = 0; i < 3; ++i) s.velocity[i] = p.velocity ? gather(p.velocity, 3, i) : Float(0.f);
            for (Float& d : s.drift) d = 0.f;
            if (p.weights) {
                const SharedMotion shared = shared_motion(p, ids);
                for (int i = 0; i < 3; ++i) s.mean[i] += shared.displacement[i], s.drift[i] = shared.drift[i];
                turn_quaternion(shared, s.quat_left);
                if (moved) *moved = shared;
            }
        }
        s.opacity_logit = gather(p.opacity_logit, 1, 0);
        return s;
    }
    SPLAT_INLINE Stored<motion, double> lane(int l) const {
        Stored<motion, double> s;
        for (int i = 0; i < (motion == Motion::kStatic ? 3 : 4); ++i) {
            s.mean[i] = lane_of(mean[i], l);
            s.log_scale[i] = lane_of(log_scale[i], l);
        }
        for (int i = 0; i < 4; ++i) {
            s.quat_left[i] = lane_of(quat_left[i], l);
            if constexpr (motion == Motion::kFull) s.quat_right[i] = lane_of(quat_right[i], l);
        }
        if constexpr (motion == Motion::kSeparable)
            for (int i = 0; i < 3; ++i)
                s.velocity[i] = lane_of(velocity[i], l), s.drift[i] = lane_of(drift[i], l);
        return s;
    }
};

// The Gaussians at time t, with the intermediate values that the backward pass needs.
template <Motion motion, class Real>
struct Slice {
    UnitQuaternion<Real> left, right;
    Real scale[4];
    Real axes[4][4];                // M; 3×3 unless motion is full
    Real dt;                        // t - μt
    Real dt_marginal;               // the same for p, t + marginal_offset - μt
    Real var_t, inverse_var;        // Σtt and its inverse
    Real log2_marginal;             // log2 p(t)
    Real velocity[3];               // h; not of static motion
    Real flow_velocity[3];          // the same with the drift
    Real offset[3];                 // μ(t) - camera position
    Real factor[3][kAxes<motion>];  // A
};

// Σtt is at least and at most this: neither 1/Σtt nor Σtt may overflow.
inline constexpr scalar kMinTimeVariance = 1e-30f, kMaxTimeVariance = 1e38f;

// v = m_t/|m_t|, given 1/√Σtt. Where Σtt is clamped, m_t is scaled by a power of two first.
template <class Real>
SPLAT_INLINE void unit_time_row(const Real (&m_t)[4], const Real& inverse_deviation, Real (&v)[4]) {
    for (int j = 0; j < 4; ++j) v[j] = m_t[j] * inverse_deviation;
    const MaskOf<Real> clamped = inverse_deviation > Real(0.999e15f);  // 1/√kMinTimeVariance is 1e15
    if (!bits(clamped)) [[likely]]
        return;
    Real scaled[4], norm2(0.f);
    for (int j = 0; j < 4; ++j) {
        scaled[j] = m_t[j] * Real(0x1p100f);
        norm2 += scaled[j] * scaled[j];
    }
    const Real inverse = Real(1.f) / sqrt(max(norm2, Real(kMinTimeVariance)));
    for (int j = 0; j < 4; ++j) v[j] = select(clamped, scaled[j] * inverse, v[j]);
}

template <Motion motion, class Real>
SPLAT_INLINE Slice<motion, Real> slice_in_time(const Stored<motion, Real>& s,
                                               const CameraOf<ScalarOf<Real>>& c) {
    Slice<motion, Real> g;
    g.left = normalise(s.quat_left);
    constexpr int kDims = motion == Motion::kStatic ? 3 : 4;
    for (int i = 0; i < kDims; ++i) g.scale[i] = exp(s.log_scale[i]);
    if constexpr (motion == Motion::kFull) {
        g.right = normalise(s.quat_right);
        rotation_4d(g.left, g.right, g.axes);
        for (int i = 0; i < 4; ++i)
            for (int j = 0; j < 4; ++j) g.axes[i][j] *= g.scale[j];
        const Real(&m_t)[4] = g.axes[3];
        g.var_t = max(m_t[0] * m_t[0] + m_t[1] * m_t[1] + m_t[2] * m_t[2] + m_t[3] * m_t[3],
                      Real(kMinTimeVariance));
    } else {
        Real R[3][3];
        rotation_3d(g.left, R);
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) g.axes[i][j] = R[i][j] * g.scale[j];
        if constexpr (motion == Motion::kSeparable)
            g.var_t = clamp(g.scale[3] * g.scale[3], Real(kMinTimeVariance), Real(kMaxTimeVariance));
    }
    if constexpr (motion == Motion::kStatic) {
        g.log2_marginal = 0.f;
    } else {
        g.dt = (Real(c.time) - s.mean[3]) + Real(c.time_low);
        g.inverse_var = Real(1.f) / g.var_t;
        g.dt_marginal = g.dt + Real(c.marginal_offset);
        g.log2_marginal = g.dt_marginal * g.dt_marginal * g.inverse_var * Real(-0.5f * kLog2E);
    }
    Real v[4];
    if constexpr (motion == Motion::kFull) unit_time_row(g.axes[3], sqrt(g.inverse_var), v);
    for (int i = 0; i < 3; ++i) {
        const Real(&m)[4] = g.axes[i];
        g.offset[i] = (s.mean[i] - Real(c.position[i])) - Real(c.position_low[i]);
        if constexpr (motion == Motion::kFull) {
            const Real(&m_t)[4] = g.axes[3];
            g.velocity[i] = (m[0] * m_t[0] + m[1] * m_t[1] + m[2] * m_t[2] + m[3] * m_t[3]) * g.inverse_var;
            g.flow_velocity[i] = g.velocity[i];
            g.offset[i] += g.velocity[i] * g.dt;
            // (I - v vᵀ) with 1 - v_k² as the sum of the other squares, which does not cancel for a huge st.
            for (int k = 0; k < 4; ++k) {
                Real others(0.f), dot_others(0.f);
                for (int j = 0; j < 4; ++j) {
                    if (j == k) continue;
                    others += v[j] * v[j];
                    dot_others += m[j] * v[j];
                }
                g.factor[i][k] = m[k] * others - v[k] * dot_others;
            }
        } else {
            if constexpr (motion == Motion::kSeparable) {
                g.velocity[i] = s.velocity[i];
                g.flow_velocity[i] = s.velocity[i] + s.drift[i];
                g.offset[i] += g.velocity[i] * g.dt;
            }
            for (int j = 0; j < 3; ++j) g.factor[i][j] = m[j];
        }
    }
    return g;
}

}  // namespace splat
