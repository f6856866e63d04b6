// Backward of forward/slice_in_time.hpp: from the gradient of the 3D Gaussian at time t to that of the stored
// parameters.
#pragma once

#include "backward/quaternion_backward.hpp"
#include "forward/slice_in_time.hpp"

namespace splat {

// ∂L/∂ the outputs of the slice.
template <Motion motion, class Real>
struct SliceGradient {
    Real mean[3];                   // of μ(t)
    Real factor[3][kAxes<motion>];  // of A
    Real log_marginal;              // of ln p(t)
    Real dt;                        // of t - μt, through the colour
    Real velocity[3];               // of h, through the flow
    Real var_t;                     // of Σtt, through the statistics
};

// ∂L/∂ the stored parameters, opacity and SH apart.
template <Motion motion, class Real>
struct StoredGradient {
    Real mean[4], log_scale[4], quat_left[4], quat_right[4], velocity[3];
    Real drift[3];  // of separable motion
};

template <Motion motion, class Real>
SPLAT_INLINE StoredGradient<motion, Real> slice_in_time_backward(const Slice<motion, Real>& g,
                                                                 const SliceGradient<motion, Real>& d) {
    StoredGradient<motion, Real> out;
    for (int i = 0; i < 3; ++i) out.mean[i] = d.mean[i];
    if constexpr (motion == Motion::kFull) {
        const Real(&m_t)[4] = g.axes[3];
        // A = M - h m_tᵀ,  μ(t) = μ + h dt,  h = u / Σtt,  u = M_xyz m_t,  ln p = -½ dt_marginal² / Σtt
        const Real relative = g.dt_marginal * g.inverse_var;
        Real d_axes[4][4], d_dt = d.dt - d.log_marginal * relative;
        Real d_var = d.var_t + d.log_marginal * Real(0.5f) * relative * relative;
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
            const Real relative = g.dt_marginal * g.inverse_var;
            Real d_dt = d.dt - d.log_marginal * relative;
            for (int i = 0; i < 3; ++i) {  // μ(t) = μ + h dt
                d_dt += d.mean[i] * g.velocity[i];
                out.velocity[i] = d.mean[i] * g.dt + d.velocity[i];
                out.drift[i] = d.velocity[i];
            }
            out.mean[3] = -d_dt;
            Real d_var = d.var_t + d.log_marginal * Real(0.5f) * relative * relative;
            out.log_scale[3] = Real(2.f) * d_var * g.var_t;
        }
    }
    return out;
}

}  // namespace splat
