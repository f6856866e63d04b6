// From stored parameters to the Gaussian at time t, its slice, and the way back (paper, section 3.2).
//
// Sixteen Gaussians at a time, one a lane. M = R diag(s), Σ = M Mᵀ. With m_t the time row of M:
//     Σtt = |m_t|²,   h = Σ_xyz,t / Σtt,   μ(t) = μ_xyz + h (t - μt),   Σ(t) = A Aᵀ,   A = M_xyz - h m_tᵀ.
// A = M_xyz (I - v vᵀ), v = m_t/|m_t|, in other words. The textbook Σ_xyz - Σ_xyz,t Σ_t,xyz / Σtt cancels in
// float32.
#pragma once

#include "rotation.hpp"

namespace splat {

// Columns of M: the axes of the ellipsoid.
template <Motion motion>
inline constexpr int kAxes = motion == Motion::kFull ? 4 : 3;

// The stored parameters of sixteen Gaussians.
template <Motion motion, class Real>
struct Stored {
    Real mean[4], log_scale[4], quat_left[4], quat_right[4], opacity_logit;

    SPLAT_INLINE static Stored load(const Parameters& p, const uint32_t* ids) {
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
        return s;
    }
};

// The Gaussians at time t, with what the backward pass needs of the way there.
template <Motion motion, class Real>
struct Slice {
    UnitQuaternion<Real> left, right;
    Real scale[4];
    Real axes[4][4];                // M; 3×3 used unless motion is full
    Real dt;                        // t - μt
    Real var_t, inverse_var;        // Σtt and its inverse
    Real log2_marginal;             // log2 p(t)
    Real velocity[3];               // h, full motion only
    Real offset[3];                 // camera centre to μ(t)
    Real factor[3][kAxes<motion>];  // A
};

// Below it 1/Σtt overflows.
inline constexpr scalar kMinTimeVariance = 1e-30f;

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
            g.var_t = max(g.scale[3] * g.scale[3], Real(kMinTimeVariance));
    }
    if constexpr (motion == Motion::kStatic) {
        g.log2_marginal = 0.f;
    } else {
        g.dt = (Real(c.time) - s.mean[3]) + Real(c.time_low);
        g.inverse_var = Real(1.f) / g.var_t;
        g.log2_marginal = g.dt * g.dt * g.inverse_var * Real(-0.5f * kLog2E);
    }
    Real v[4];
    if constexpr (motion == Motion::kFull)
        for (int j = 0; j < 4; ++j) v[j] = g.axes[3][j] * sqrt(g.inverse_var);
    for (int i = 0; i < 3; ++i) {
        const Real(&m)[4] = g.axes[i];
        g.offset[i] = (s.mean[i] - Real(c.position[i])) - Real(c.position_low[i]);
        if constexpr (motion == Motion::kFull) {
            const Real(&m_t)[4] = g.axes[3];
            g.velocity[i] = (m[0] * m_t[0] + m[1] * m_t[1] + m[2] * m_t[2] + m[3] * m_t[3]) * g.inverse_var;
            g.offset[i] += g.velocity[i] * g.dt;
            // (I - v vᵀ) with 1 - v_k² as the sum of the other squares: a huge st cancels nothing.
            for (int k = 0; k < 4; ++k) {
                Real others(0.f), along(0.f);
                for (int j = 0; j < 4; ++j) {
                    if (j == k) continue;
                    others += v[j] * v[j];
                    along += m[j] * v[j];
                }
                g.factor[i][k] = m[k] * others - v[k] * along;
            }
        } else {
            for (int j = 0; j < 3; ++j) g.factor[i][j] = m[j];
        }
    }
    return g;
}

// ∂L/∂ of what a slice gives.
template <Motion motion, class Real>
struct SliceGradient {
    Real mean[3];                   // of μ(t)
    Real factor[3][kAxes<motion>];  // of A
    Real log_marginal;              // of ln p(t)
    Real dt;                        // of t - μt directly (colour)
    Real velocity[3];               // of h directly (flow)
    Real var_t;                     // of Σtt directly (statistics)
};

template <Motion motion, class Real>
struct StoredGradient {
    Real mean[4], log_scale[4], quat_left[4], quat_right[4];
};

template <Motion motion, class Real>
SPLAT_INLINE StoredGradient<motion, Real> slice_in_time_backward(const Slice<motion, Real>& g,
                                                                 const SliceGradient<motion, Real>& d) {
    StoredGradient<motion, Real> out;
    for (int i = 0; i < 3; ++i) out.mean[i] = d.mean[i];
    if constexpr (motion == Motion::kFull) {
        const Real(&m_t)[4] = g.axes[3];
        // A = M - h m_tᵀ,  μ(t) = μ + h dt,  h = u / Σtt,  u = M_xyz m_t,  ln p = -½ dt² / Σtt
        Real d_axes[4][4], d_dt = d.dt - d.log_marginal * g.dt * g.inverse_var;
        Real d_var = d.var_t + d.log_marginal * Real(0.5f) * (g.dt * g.inverse_var) * (g.dt * g.inverse_var);
        for (int j = 0; j < 4; ++j) d_axes[3][j] = 0.f;
        for (int i = 0; i < 3; ++i) {
            Real d_h = d.mean[i] * g.dt + d.velocity[i];
            for (int j = 0; j < 4; ++j) {
                d_h -= d.factor[i][j] * m_t[j];
                d_axes[3][j] -= d.factor[i][j] * g.velocity[i];
            }
            d_dt += d.mean[i] * g.velocity[i];
            Real d_u = d_h * g.inverse_var;
            d_var -= d_u * g.velocity[i];
            for (int j = 0; j < 4; ++j) {
                d_axes[i][j] = d.factor[i][j] + d_u * m_t[j];
                d_axes[3][j] += d_u * g.axes[i][j];
            }
        }
        for (int j = 0; j < 4; ++j) d_axes[3][j] += Real(2.f) * d_var * m_t[j];
        out.mean[3] = -d_dt;
        for (int j = 0; j < 4; ++j) {  // M = R diag(s)
            out.log_scale[j] = d_axes[0][j] * g.axes[0][j] + d_axes[1][j] * g.axes[1][j] +
                               d_axes[2][j] * g.axes[2][j] + d_axes[3][j] * g.axes[3][j];
            for (int i = 0; i < 4; ++i) d_axes[i][j] *= g.scale[j];
        }
        Real d_left[4], d_right[4];
        rotation_4d_backward(g.left, g.right, d_axes, d_left, d_right);
        normalise_backward(g.left, d_left, out.quat_left);
        normalise_backward(g.right, d_right, out.quat_right);
    } else {
        Real dR[3][3], d_left[4];
        for (int j = 0; j < 3; ++j) {
            out.log_scale[j] = 0.f;
            for (int i = 0; i < 3; ++i) {
                out.log_scale[j] += d.factor[i][j] * g.factor[i][j];
                dR[i][j] = d.factor[i][j] * g.scale[j];
            }
        }
        rotation_3d_backward(g.left, dR, d_left);
        normalise_backward(g.left, d_left, out.quat_left);
        if constexpr (motion == Motion::kSeparable) {
            out.mean[3] = d.log_marginal * g.dt * g.inverse_var - d.dt;
            Real d_var =
                d.var_t + d.log_marginal * Real(0.5f) * (g.dt * g.inverse_var) * (g.dt * g.inverse_var);
            out.log_scale[3] = Real(2.f) * d_var * g.var_t;
        }
    }
    return out;
}

}  // namespace splat
