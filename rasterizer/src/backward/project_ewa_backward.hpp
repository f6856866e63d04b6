// Backward of forward/project_ewa.hpp: from gradients of mean2d and conic to gradients of μ(t) and Σ(t).
#pragma once

#include "forward/project_ewa.hpp"

namespace splat {

template <class Real>
SPLAT_INLINE void camera_to_world_direction(const ScalarOf<Real> (&rotation)[3][3], const Real (&cam)[3],
                                            Real (&world)[3]) {
    for (int i = 0; i < 3; ++i)
        world[i] =
            Real(rotation[0][i]) * cam[0] + Real(rotation[1][i]) * cam[1] + Real(rotation[2][i]) * cam[2];
}

// ∂L/∂ the outputs of the projection.
template <class Real>
struct EwaProjectionGradient {
    Real pixel[2];
    Real shear, var_u, var_v;  // of k, V and C, each with the other two constant
    Real depth;                // of z, through the depth image
};

// Writes ∂L/∂μ(t) and ∂L/∂A.
template <Motion motion, class Real>
SPLAT_INLINE void project_ewa_backward(const EwaProjection<motion, Real>& p, const Slice<motion, Real>& g,
                                       const CameraOf<ScalarOf<Real>>& c,
                                       const EwaProjectionGradient<Real>& d, Real (&d_mean)[3],
                                       Real (&d_factor)[3][kAxes<motion>]) {
    constexpr int kColumns = kAxes<motion>;
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    // k = -cov_xy/C, V = cov_xx - cov_xy²/C, C = cov_yy. r = b₀ + k b₁ suffers from cancellation along a
    // needle, so it is computed from the minors: C r_j = 0.3 b₀_j + Σ_i b₁_i (b₀_j b₁_i - b₀_i b₁_j).
    const Real d_shear = d.shear * p.inverse_var_v, two(2.f);
    Real d_b[2][kColumns];
    for (int j = 0; j < kColumns; ++j) {
        Real r = Real(kDilation) * p.b[0][j];
        for (int i = 0; i < kColumns; ++i)
            if (i != j) r += p.b[1][i] * (p.b[0][j] * p.b[1][i] - p.b[0][i] * p.b[1][j]);
        r *= p.inverse_var_v;
        const Real d_r = two * d.var_u * r;
        d_b[0][j] = d_r - d_shear * p.b[1][j];
        d_b[1][j] = two * d.var_v * p.b[1][j] + p.shear * d_r - d_shear * (r + p.shear * p.b[1][j]);
    }
    // B = (J W) A
    Real d_jw[2][3];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < kColumns; ++j) d_factor[i][j] = p.jw[0][i] * d_b[0][j] + p.jw[1][i] * d_b[1][j];
        for (int r = 0; r < 2; ++r) {
            d_jw[r][i] = 0.f;
            for (int j = 0; j < kColumns; ++j) d_jw[r][i] += d_b[r][j] * g.factor[i][j];
        }
    }
    // With n = cam / z: row r of J W = focal/z (W_r - n_r W_2), and pixel = focal n + principal point.
    Real d_inverse_z(0.f), d_cam[3];
    for (int r = 0; r < 2; ++r) {
        Real d_axis(0.f), d_axis_z(0.f);
        for (int j = 0; j < 3; ++j) {
            d_axis += d_jw[r][j] * Real(c.rotation[r][j]);
            d_axis_z += d_jw[r][j] * Real(c.rotation[2][j]);
        }
        d_inverse_z += Real(focal[r]) * (d_axis - d_axis_z * p.clamped_normalised[r]);
        Real d_normalised = zero_unless(p.not_clamped[r], -(Real(focal[r]) * p.inverse_z * d_axis_z));
        d_normalised += Real(focal[r]) * d.pixel[r];
        d_cam[r] = d_normalised * p.inverse_z;
        d_inverse_z += d_normalised * p.cam[r];
    }
    d_cam[2] = d.depth - d_inverse_z * p.inverse_z * p.inverse_z;
    camera_to_world_direction<Real>(c.rotation, d_cam, d_mean);
}

// Adds to ∂L/∂μ(t) and ∂L/∂h, and to ∂L/∂mean2d what goes through the mean's present projection.
template <class Real>
SPLAT_INLINE void flow_backward(const Flow<Real>& f, const CameraOf<ScalarOf<Real>>& c, scalar flow_dt,
                                const Real (&d_flow)[2], Real (&d_mean2d)[2], Real (&d_mean)[3],
                                Real (&d_velocity)[3]) {
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    Real d_cam[3], d_inverse_z(0.f), d_later[3];
    for (int a = 0; a < 2; ++a) {
        Real d = zero_unless(f.valid, d_flow[a]);
        d_mean2d[a] -= d;
        Real d_normalised = Real(focal[a] + c.flow_camera.focal_change[a]) * d;
        d_cam[a] = d_normalised * f.later_inverse_z;
        d_inverse_z += d_normalised * f.later_cam[a];
    }
    d_cam[2] = -d_inverse_z * f.later_inverse_z * f.later_inverse_z;
    camera_to_world_direction<Real>(c.flow_camera.rotation, d_cam, d_later);
    for (int i = 0; i < 3; ++i) {
        d_mean[i] += d_later[i];
        d_velocity[i] += d_later[i] * Real(flow_dt);
    }
}

}  // namespace splat
