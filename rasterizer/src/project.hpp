// From the Gaussian at time t to an ellipse on the screen, and back (EWA splatting; docs/method.md 1.2).
//
// With W the camera's rotation, J the Jacobian of the pinhole at the mean and A the factor of Σ(t):
//     B = J W A (2×k),  Σ2d = B Bᵀ + 0.3 I,  det Σ2d = Σ (2×2 minors of B)² + 0.3 |B|² + 0.09 (Cauchy–Binet).
// cxx cyy - cxy² would cancel for long streaks; the sum of squares cannot. Nor can Σ2d⁻¹ as a sum of two
// squares, which is what blending evaluates: with C = cyy, k = -cxy/C and V = det/C,
//     dᵀ Σ2d⁻¹ d = (dx + k dy)²/V + dy²/C,   dx + k dy = (px - x₀) + k py,   x₀ = x + k y.
#pragma once

#include "geometry.hpp"

namespace splat {

template <Motion motion, class Real>
struct Projection {
    Real cam[3];  // μ(t) in the camera's frame
    Real inverse_z;
    Real slope[2];               // x/z, y/z
    Real clamped_slope[2];       // the same inside 1.3 × the field of view
    MaskOf<Real> slope_free[2];  // not clamped
    Real jw[2][3];               // J W
    Real b[2][kAxes<motion>];
    Real cov_xx, cov_xy, cov_yy;
    Real lean, intercept, inverse_across, inverse_along;  // Σ2d⁻¹ as two squares, see above
    Real pixel[2];
};

// clamp limits on each side of the principal point, in units of x/z
template <class Real>
struct FrustumLimits {
    ScalarOf<Real> low[2], high[2];
    explicit FrustumLimits(const CameraOf<ScalarOf<Real>>& c)
        : low{-kFrustumMargin * c.cx / c.fx, -kFrustumMargin * c.cy / c.fy},
          high{kFrustumMargin * (c.width - c.cx) / c.fx, kFrustumMargin * (c.height - c.cy) / c.fy} {}
};

template <class Real>
SPLAT_INLINE void world_to_camera(const CameraOf<ScalarOf<Real>>& c, const Real (&offset)[3],
                                  Real (&cam)[3]) {
    for (int i = 0; i < 3; ++i)
        cam[i] = Real(c.rotation[i][0]) * offset[0] + Real(c.rotation[i][1]) * offset[1] +
                 Real(c.rotation[i][2]) * offset[2];
}
template <class Real>
SPLAT_INLINE void camera_to_world_direction(const CameraOf<ScalarOf<Real>>& c, const Real (&cam)[3],
                                            Real (&world)[3]) {
    for (int i = 0; i < 3; ++i)
        world[i] = Real(c.rotation[0][i]) * cam[0] + Real(c.rotation[1][i]) * cam[1] +
                   Real(c.rotation[2][i]) * cam[2];
}

template <Motion motion, class Real>
SPLAT_INLINE Projection<motion, Real> project(const Slice<motion, Real>& g,
                                              const CameraOf<ScalarOf<Real>>& c) {
    constexpr int kColumns = kAxes<motion>;
    const FrustumLimits<Real> limit(c);
    const ScalarOf<Real> focal[2] = {c.fx, c.fy}, centre[2] = {c.cx, c.cy};
    Projection<motion, Real> p;
    world_to_camera<Real>(c, g.offset, p.cam);
    p.inverse_z = Real(1.f) / p.cam[2];
    for (int a = 0; a < 2; ++a) {
        p.slope[a] = p.cam[a] * p.inverse_z;
        p.clamped_slope[a] = clamp(p.slope[a], limit.low[a], limit.high[a]);
        p.slope_free[a] = (p.slope[a] >= Real(limit.low[a])) & (p.slope[a] <= Real(limit.high[a]));
        Real focal_over_z = p.inverse_z * Real(focal[a]);
        for (int j = 0; j < 3; ++j)
            p.jw[a][j] =
                focal_over_z * (Real(c.rotation[a][j]) - p.clamped_slope[a] * Real(c.rotation[2][j]));
        for (int j = 0; j < kColumns; ++j)
            p.b[a][j] =
                p.jw[a][0] * g.factor[0][j] + p.jw[a][1] * g.factor[1][j] + p.jw[a][2] * g.factor[2][j];
        p.pixel[a] =
            Real(focal[a]) * p.slope[a] + Real(centre[a] - 0.5f);  // pixel centres at integers from here on
    }
    Real norm_x(0.f), norm_y(0.f), minors(0.f);
    p.cov_xy = 0.f;
    for (int j = 0; j < kColumns; ++j) {
        norm_x += p.b[0][j] * p.b[0][j];
        norm_y += p.b[1][j] * p.b[1][j];
        p.cov_xy += p.b[0][j] * p.b[1][j];
        for (int k = j + 1; k < kColumns; ++k) {
            Real minor = p.b[0][j] * p.b[1][k] - p.b[0][k] * p.b[1][j];
            minors += minor * minor;
        }
    }
    p.cov_xx = norm_x + Real(kDilation);
    p.cov_yy = norm_y + Real(kDilation);
    Real det = minors + Real(kDilation) * (norm_x + norm_y) + Real(kDilation * kDilation);
    p.inverse_along = Real(1.f) / p.cov_yy;
    p.inverse_across = p.cov_yy / det;
    p.lean = -p.cov_xy * p.inverse_along;
    p.intercept = p.pixel[0] + p.lean * p.pixel[1];
    return p;
}

// ∂L/∂ of what a projection gives.
template <class Real>
struct ProjectionGradient {
    Real pixel[2];
    Real lean, across, along;  // of k, V and C, each with the two others held
    Real depth;                // of z, directly
    Real flow[2];              // of proj(μ(t+δ)) - proj(μ(t)); read only when the frame has flow
};

// ∂L/∂μ(t) and ∂L/∂A. d_cam_flow, d_slope_flow: what flow adds to the camera-frame mean and the slopes, else
// zeros.
template <Motion motion, class Real>
SPLAT_INLINE void project_backward(const Projection<motion, Real>& p, const Slice<motion, Real>& g,
                                   const CameraOf<ScalarOf<Real>>& c, const ProjectionGradient<Real>& d,
                                   Real (&d_mean)[3], Real (&d_factor)[3][kAxes<motion>]) {
    constexpr int kColumns = kAxes<motion>;
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    // k = -cov_xy/C, V = cov_xx - cov_xy²/C, C = cov_yy. r = b₀ + k b₁ cancels along a needle, so it is taken
    // from the minors: C r_j = 0.3 b₀_j + Σ_i b₁_i (b₀_j b₁_i - b₀_i b₁_j).
    const Real d_lean = d.lean * p.inverse_along, two(2.f);
    Real d_b[2][kColumns];
    for (int j = 0; j < kColumns; ++j) {
        Real r = Real(kDilation) * p.b[0][j];
        for (int i = 0; i < kColumns; ++i)
            if (i != j) r += p.b[1][i] * (p.b[0][j] * p.b[1][i] - p.b[0][i] * p.b[1][j]);
        r *= p.inverse_along;
        const Real d_r = two * d.across * r;
        d_b[0][j] = d_r - d_lean * p.b[1][j];
        d_b[1][j] = two * d.along * p.b[1][j] + p.lean * d_r - d_lean * (r + p.lean * p.b[1][j]);
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
    // row r of J W = focal/z (W_r - slope W_2);  pixel = focal slope + centre;  slope = cam / z
    Real d_inverse_z(0.f), d_cam[3];
    for (int r = 0; r < 2; ++r) {
        Real along(0.f), forward(0.f);
        for (int j = 0; j < 3; ++j) {
            along += d_jw[r][j] * Real(c.rotation[r][j]);
            forward += d_jw[r][j] * Real(c.rotation[2][j]);
        }
        d_inverse_z += Real(focal[r]) * (along - forward * p.clamped_slope[r]);
        Real d_slope = zero_unless(p.slope_free[r], -(Real(focal[r]) * p.inverse_z * forward));
        d_slope += Real(focal[r]) * d.pixel[r];
        d_cam[r] = d_slope * p.inverse_z;
        d_inverse_z += d_slope * p.cam[r];
    }
    d_cam[2] = d.depth - d_inverse_z * p.inverse_z * p.inverse_z;
    camera_to_world_direction<Real>(c, d_cam, d_mean);
}

// Optical flow: how far the mean's projection moves in δ, pixels; 0 where it would reach the near plane.
template <class Real>
struct Flow {
    Real pixel[2];
    Real later_cam[3], later_slope[2], later_inverse_z;
    MaskOf<Real> valid;
};
template <class Real>
SPLAT_INLINE Flow<Real> flow_of(const Slice<Motion::kFull, Real>& g, const Projection<Motion::kFull, Real>& p,
                                const CameraOf<ScalarOf<Real>>& c, scalar flow_dt, scalar near_plane) {
    Flow<Real> f;
    Real later[3];
    for (int i = 0; i < 3; ++i) later[i] = g.offset[i] + g.velocity[i] * Real(flow_dt);
    world_to_camera<Real>(c, later, f.later_cam);
    f.valid = f.later_cam[2] > Real(near_plane);
    f.later_inverse_z = Real(1.f) / select(f.valid, f.later_cam[2], Real(1.f));
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    for (int a = 0; a < 2; ++a) {
        f.later_slope[a] = f.later_cam[a] * f.later_inverse_z;
        f.pixel[a] = zero_unless(f.valid, Real(focal[a]) * (f.later_slope[a] - p.slope[a]));
    }
    return f;
}
// Adds to ∂L/∂μ(t) and ∂L/∂h; the part through proj(μ(t)) goes into d_pixel.
template <class Real>
SPLAT_INLINE void flow_backward(const Flow<Real>& f, const CameraOf<ScalarOf<Real>>& c, scalar flow_dt,
                                const Real (&d_flow)[2], Real (&d_pixel)[2], Real (&d_mean)[3],
                                Real (&d_velocity)[3]) {
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    Real d_cam[3], d_inverse_z(0.f), d_later[3];
    for (int a = 0; a < 2; ++a) {
        Real d = zero_unless(f.valid, d_flow[a]);
        d_pixel[a] -= d;
        Real d_slope = Real(focal[a]) * d;
        d_cam[a] = d_slope * f.later_inverse_z;
        d_inverse_z += d_slope * f.later_cam[a];
    }
    d_cam[2] = -d_inverse_z * f.later_inverse_z * f.later_inverse_z;
    camera_to_world_direction<Real>(c, d_cam, d_later);
    for (int i = 0; i < 3; ++i) {
        d_mean[i] += d_later[i];
        d_velocity[i] += d_later[i] * Real(flow_dt);
    }
}

}  // namespace splat
