// From the Gaussian at time t to an ellipse on the screen, and back (EWA splatting; SPEC 1, Projection).
//
// With W the camera's rotation, J the Jacobian of the pinhole at the mean and A the factor of Σ(t):
//     B = J W A (2×k),  Σ2d = B Bᵀ + 0.3 I,  det Σ2d = Σ (2×2 minors of B)² + 0.3 |B|² + 0.09 (Cauchy–Binet).
// cxx cyy - cxy² would cancel for long streaks; the sum of squares cannot.
#pragma once

#include "geometry.hpp"

namespace splat {

template <Motion motion>
struct Projection {
    Float cam[3];  // μ(t) in the camera's frame
    Float inverse_z;
    Float slope[2];          // x/z, y/z
    Float clamped_slope[2];  // the same inside 1.3 × the field of view
    Mask slope_free[2];      // not clamped
    Float jw[2][3];          // J W
    Float b[2][kAxes<motion>];
    Float cov_xx, cov_xy, cov_yy;
    Float conic_xx, conic_xy, conic_yy;  // Σ2d⁻¹
    Float pixel[2];
};

// clamp limits on each side of the principal point, in units of x/z
struct FrustumLimits {
    float low[2], high[2];
    explicit FrustumLimits(const Camera& c)
        : low{-kFrustumMargin * c.cx / c.fx, -kFrustumMargin * c.cy / c.fy},
          high{kFrustumMargin * (c.width - c.cx) / c.fx, kFrustumMargin * (c.height - c.cy) / c.fy} {}
};

SPLAT_INLINE void world_to_camera(const Camera& c, const Float (&world)[3], Float (&cam)[3]) {
    for (int i = 0; i < 3; ++i)
        cam[i] = Float(c.rotation[i][0]) * world[0] + Float(c.rotation[i][1]) * world[1] +
                 Float(c.rotation[i][2]) * world[2] + Float(c.translation[i]);
}
SPLAT_INLINE void camera_to_world_direction(const Camera& c, const Float (&cam)[3], Float (&world)[3]) {
    for (int i = 0; i < 3; ++i)
        world[i] = Float(c.rotation[0][i]) * cam[0] + Float(c.rotation[1][i]) * cam[1] +
                   Float(c.rotation[2][i]) * cam[2];
}

template <Motion motion>
SPLAT_INLINE Projection<motion> project(const Slice<motion>& g, const Camera& c) {
    constexpr int kColumns = kAxes<motion>;
    const FrustumLimits limit(c);
    const float focal[2] = {c.fx, c.fy}, centre[2] = {c.cx, c.cy};
    Projection<motion> p;
    world_to_camera(c, g.mean, p.cam);
    p.inverse_z = Float(1.f) / p.cam[2];
    for (int a = 0; a < 2; ++a) {
        p.slope[a] = p.cam[a] * p.inverse_z;
        p.clamped_slope[a] = clamp(p.slope[a], limit.low[a], limit.high[a]);
        p.slope_free[a] = (p.slope[a] >= Float(limit.low[a])) & (p.slope[a] <= Float(limit.high[a]));
        Float focal_over_z = p.inverse_z * Float(focal[a]);
        for (int j = 0; j < 3; ++j)
            p.jw[a][j] =
                focal_over_z * (Float(c.rotation[a][j]) - p.clamped_slope[a] * Float(c.rotation[2][j]));
        for (int j = 0; j < kColumns; ++j)
            p.b[a][j] =
                p.jw[a][0] * g.factor[0][j] + p.jw[a][1] * g.factor[1][j] + p.jw[a][2] * g.factor[2][j];
        p.pixel[a] =
            Float(focal[a]) * p.slope[a] + Float(centre[a] - 0.5f);  // pixel centres at integers from here on
    }
    Float norm_x(0.f), norm_y(0.f), minors(0.f);
    p.cov_xy = 0.f;
    for (int j = 0; j < kColumns; ++j) {
        norm_x += p.b[0][j] * p.b[0][j];
        norm_y += p.b[1][j] * p.b[1][j];
        p.cov_xy += p.b[0][j] * p.b[1][j];
        for (int k = j + 1; k < kColumns; ++k) {
            Float minor = p.b[0][j] * p.b[1][k] - p.b[0][k] * p.b[1][j];
            minors += minor * minor;
        }
    }
    p.cov_xx = norm_x + Float(kDilation);
    p.cov_yy = norm_y + Float(kDilation);
    Float det = minors + Float(kDilation) * (norm_x + norm_y) + Float(kDilation * kDilation);
    Float inverse_det = Float(1.f) / det;
    p.conic_xx = p.cov_yy * inverse_det;
    p.conic_xy = -p.cov_xy * inverse_det;
    p.conic_yy = p.cov_xx * inverse_det;
    return p;
}

// ∂L/∂ of what a projection gives. conic_xy is the coefficient of -dx dy in ln alpha.
struct ProjectionGradient {
    Float pixel[2];
    Float conic_xx, conic_xy, conic_yy;
    Float depth;    // of z, directly
    Float flow[2];  // of proj(μ(t+δ)) - proj(μ(t)); read only when the frame has flow
};

// ∂L/∂μ(t) and ∂L/∂A. d_cam_flow, d_slope_flow: what flow adds to the camera-frame mean and the slopes, else
// zeros.
template <Motion motion>
SPLAT_INLINE void project_backward(const Projection<motion>& p, const Slice<motion>& g, const Camera& c,
                                   const ProjectionGradient& d, Float (&d_mean)[3],
                                   Float (&d_factor)[3][kAxes<motion>]) {
    constexpr int kColumns = kAxes<motion>;
    const float focal[2] = {c.fx, c.fy};
    // K = Σ⁻¹:  dΣ = -K dK K
    const Float &a = p.conic_xx, &b = p.conic_xy, &e = p.conic_yy;
    Float half = Float(0.5f) * d.conic_xy;
    Float t00 = d.conic_xx * a + half * b, t01 = d.conic_xx * b + half * e;
    Float t10 = half * a + d.conic_yy * b, t11 = half * b + d.conic_yy * e;
    Float d_xx = -(a * t00 + b * t10), d_xy = -(a * t01 + b * t11) - (b * t00 + e * t10),
          d_yy = -(b * t01 + e * t11);
    // Σ = B Bᵀ + 0.3 I
    Float d_b[2][kColumns];
    for (int j = 0; j < kColumns; ++j) {
        d_b[0][j] = Float(2.f) * d_xx * p.b[0][j] + d_xy * p.b[1][j];
        d_b[1][j] = Float(2.f) * d_yy * p.b[1][j] + d_xy * p.b[0][j];
    }
    // B = (J W) A
    Float d_jw[2][3];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < kColumns; ++j) d_factor[i][j] = p.jw[0][i] * d_b[0][j] + p.jw[1][i] * d_b[1][j];
        for (int r = 0; r < 2; ++r) {
            d_jw[r][i] = 0.f;
            for (int j = 0; j < kColumns; ++j) d_jw[r][i] += d_b[r][j] * g.factor[i][j];
        }
    }
    // row r of J W = focal/z (W_r - slope W_2);  pixel = focal slope + centre;  slope = cam / z
    Float d_inverse_z(0.f), d_cam[3];
    for (int r = 0; r < 2; ++r) {
        Float along(0.f), forward(0.f);
        for (int j = 0; j < 3; ++j) {
            along += d_jw[r][j] * Float(c.rotation[r][j]);
            forward += d_jw[r][j] * Float(c.rotation[2][j]);
        }
        d_inverse_z += Float(focal[r]) * (along - forward * p.clamped_slope[r]);
        Float d_slope = zero_unless(p.slope_free[r], -(Float(focal[r]) * p.inverse_z * forward));
        d_slope += Float(focal[r]) * d.pixel[r];
        d_cam[r] = d_slope * p.inverse_z;
        d_inverse_z += d_slope * p.cam[r];
    }
    d_cam[2] = d.depth - d_inverse_z * p.inverse_z * p.inverse_z;
    camera_to_world_direction(c, d_cam, d_mean);
}

// Optical flow: how far the mean's projection moves in δ, pixels; 0 where it would reach the near plane.
struct Flow {
    Float pixel[2];
    Float later_cam[3], later_slope[2], later_inverse_z;
    Mask valid;
};
SPLAT_INLINE Flow flow_of(const Slice<Motion::kFull>& g, const Projection<Motion::kFull>& p, const Camera& c,
                          float flow_dt, float near_plane) {
    Flow f;
    Float later[3];
    for (int i = 0; i < 3; ++i) later[i] = g.mean[i] + g.velocity[i] * Float(flow_dt);
    world_to_camera(c, later, f.later_cam);
    f.valid = f.later_cam[2] > Float(near_plane);
    f.later_inverse_z = Float(1.f) / select(f.valid, f.later_cam[2], 1.f);
    const float focal[2] = {c.fx, c.fy};
    for (int a = 0; a < 2; ++a) {
        f.later_slope[a] = f.later_cam[a] * f.later_inverse_z;
        f.pixel[a] = zero_unless(f.valid, Float(focal[a]) * (f.later_slope[a] - p.slope[a]));
    }
    return f;
}
// Adds to ∂L/∂μ(t) and ∂L/∂h; the part through proj(μ(t)) goes into d_pixel.
SPLAT_INLINE void flow_backward(const Flow& f, const Camera& c, float flow_dt, const Float (&d_flow)[2],
                                Float (&d_pixel)[2], Float (&d_mean)[3], Float (&d_velocity)[3]) {
    const float focal[2] = {c.fx, c.fy};
    Float d_cam[3], d_inverse_z(0.f), d_later[3];
    for (int a = 0; a < 2; ++a) {
        Float d = zero_unless(f.valid, d_flow[a]);
        d_pixel[a] -= d;
        Float d_slope = Float(focal[a]) * d;
        d_cam[a] = d_slope * f.later_inverse_z;
        d_inverse_z += d_slope * f.later_cam[a];
    }
    d_cam[2] = -d_inverse_z * f.later_inverse_z * f.later_inverse_z;
    camera_to_world_direction(c, d_cam, d_later);
    for (int i = 0; i < 3; ++i) {
        d_mean[i] += d_later[i];
        d_velocity[i] += d_later[i] * Float(flow_dt);
    }
}

}  // namespace splat
