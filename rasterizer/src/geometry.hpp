// From stored parameters to the Gaussian at time t: rotation, slice in time, and their derivatives (paper,
// section 3.2).
//
// Sixteen Gaussians at a time, one a lane. M = R diag(s), Σ = M Mᵀ. With m_t the time row of M:
//     Σtt = |m_t|²,   h = Σ_xyz,t / Σtt,   μ(t) = μ_xyz + h (t - μt),   Σ(t) = A Aᵀ,   A = M_xyz - h m_tᵀ.
// A = M_xyz (I - v vᵀ), v = m_t/|m_t|, in other words. The textbook Σ_xyz - Σ_xyz,t Σ_t,xyz / Σtt cancels in
// float32.
#pragma once

#include "exact.hpp"
#include "types.hpp"
#include "vec_move.hpp"

namespace splat {

// Columns of M: the axes of the ellipsoid.
template <Motion motion>
inline constexpr int kAxes = motion == Motion::kFull ? 4 : 3;

// 1/|q| is cut off here, so that the gradient of a denormal quaternion stays finite.
inline constexpr float kLargestInverse = 1e30f;

template <class Real>
struct UnitQuaternion {
    Real q[4];
    Real inverse_norm;
};

// q/|q|; zero is read as identity. Scaled by a power of two first where a square would over- or underflow.
template <class Real>
SPLAT_INLINE UnitQuaternion<Real> normalise(const Real (&q)[4]) {
    const Real largest = max(max(abs(q[0]), abs(q[1])), max(abs(q[2]), abs(q[3])));
    const MaskOf<Real> usable = largest > Real(0.f);
    const Real scale = select(largest < Real(0x1p-40f), Real(0x1p100f),
                              select(largest > Real(0x1p40f), Real(0x1p-100f), Real(1.f)));
    Real s[4], norm2(0.f);
    for (int i = 0; i < 4; ++i) {
        s[i] = q[i] * scale;
        norm2 += s[i] * s[i];
    }
    const Real inverse = zero_unless(usable, Real(1.f) / sqrt(norm2));
    UnitQuaternion<Real> u;
    for (int i = 0; i < 4; ++i) u.q[i] = s[i] * inverse;
    u.q[0] = select(usable, u.q[0], Real(1.f));
    u.inverse_norm = min(inverse * scale, Real(kLargestInverse));
    return u;
}
// ∂L/∂q from ∂L/∂(q/|q|): the part along q has no effect.
template <class Real>
SPLAT_INLINE void normalise_backward(const UnitQuaternion<Real>& u, const Real (&d_unit)[4], Real (&d_q)[4]) {
    Real along(0.f);
    for (int i = 0; i < 4; ++i) along += d_unit[i] * u.q[i];
    for (int i = 0; i < 4; ++i) d_q[i] = (d_unit[i] - along * u.q[i]) * u.inverse_norm;
}

// L(q)[i][j] = kLeftSign[i][j] q[kQuatIndex[i][j]], R(q) likewise with kRightSign (SPEC 1).
inline constexpr int kQuatIndex[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}};
inline constexpr float kLeftSign[4][4] = {{1, -1, -1, -1}, {1, 1, -1, 1}, {1, 1, 1, -1}, {1, -1, 1, 1}};
inline constexpr float kRightSign[4][4] = {{1, -1, -1, -1}, {1, 1, 1, -1}, {1, -1, 1, 1}, {1, 1, -1, 1}};

template <class Real>
SPLAT_INLINE Real left_matrix(const UnitQuaternion<Real>& u, int i, int j) {
    return u.q[kQuatIndex[i][j]] * Real(kLeftSign[i][j]);
}
template <class Real>
SPLAT_INLINE Real right_matrix(const UnitQuaternion<Real>& u, int i, int j) {
    return u.q[kQuatIndex[i][j]] * Real(kRightSign[i][j]);
}

// The 4D rotation L(ql) R(qr).
template <class Real>
SPLAT_INLINE void rotation_4d(const UnitQuaternion<Real>& left, const UnitQuaternion<Real>& right,
                              Real (&R)[4][4]) {
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i)
#pragma GCC unroll 4
        for (int j = 0; j < 4; ++j) {
            R[i][j] = left_matrix(left, i, 0) * right_matrix(right, 0, j);
#pragma GCC unroll 4
            for (int k = 1; k < 4; ++k) R[i][j] += left_matrix(left, i, k) * right_matrix(right, k, j);
        }
}
template <class Real>
SPLAT_INLINE void rotation_4d_backward(const UnitQuaternion<Real>& left, const UnitQuaternion<Real>& right,
                                       const Real (&dR)[4][4], Real (&d_left)[4], Real (&d_right)[4]) {
    for (int i = 0; i < 4; ++i) d_left[i] = d_right[i] = 0.f;
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i)
#pragma GCC unroll 4
        for (int j = 0; j < 4; ++j) {
            Real dL = dR[i][0] * right_matrix(right, j, 0), dQ = left_matrix(left, 0, i) * dR[0][j];
#pragma GCC unroll 4
            for (int k = 1; k < 4; ++k) {
                dL += dR[i][k] * right_matrix(right, j, k);
                dQ += left_matrix(left, k, i) * dR[k][j];
            }
            d_left[kQuatIndex[i][j]] += dL * Real(kLeftSign[i][j]);
            d_right[kQuatIndex[i][j]] += dQ * Real(kRightSign[i][j]);
        }
}

// The 3D rotation of the unit quaternion (w, x, y, z).
template <class Real>
SPLAT_INLINE void rotation_3d(const UnitQuaternion<Real>& u, Real (&R)[3][3]) {
    const Real &w = u.q[0], &x = u.q[1], &y = u.q[2], &z = u.q[3];
    const Real one(1.f), two(2.f);
    R[0][0] = one - two * (y * y + z * z), R[0][1] = two * (x * y - w * z), R[0][2] = two * (x * z + w * y);
    R[1][0] = two * (x * y + w * z), R[1][1] = one - two * (x * x + z * z), R[1][2] = two * (y * z - w * x);
    R[2][0] = two * (x * z - w * y), R[2][1] = two * (y * z + w * x), R[2][2] = one - two * (x * x + y * y);
}
template <class Real>
SPLAT_INLINE void rotation_3d_backward(const UnitQuaternion<Real>& u, const Real (&d)[3][3], Real (&dq)[4]) {
    const Real &w = u.q[0], &x = u.q[1], &y = u.q[2], &z = u.q[3];
    const Real two(2.f);
    dq[0] = two * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
    dq[1] = two * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2]) -
                   two * x * (d[1][1] + d[2][2]));
    dq[2] = two * (x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0]) -
                   two * y * (d[0][0] + d[2][2]));
    dq[3] = two * (x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1]) -
                   two * z * (d[0][0] + d[1][1]));
}

// The stored parameters of sixteen Gaussians.
template <Motion motion, class Real>
struct Stored {
    Real mean[4], log_scale[4], quat_left[4], quat_right[4], opacity_logit;

    SPLAT_INLINE static Stored load(const Parameters& p, const uint32_t* ids) {
        Stored s;
        auto gather = [&](const float* base, int stride, int column) {
            alignas(64) float lane[kLanes];
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
inline constexpr float kMinTimeVariance = 1e-30f;

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
