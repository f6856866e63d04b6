// Projects 3D Gaussians to 2D Gaussians on the screen: EWA splatting (docs/method.md 1.2).
//
// With W the camera's rotation, J the Jacobian of the pinhole projection at the mean, and Σ(t) = A Aᵀ:
//     B = J W A (2×k),  Σ2d = B Bᵀ + 0.3 I,  det Σ2d = Σ (2×2 minors of B)² + 0.3 |B|² + 0.09 (Cauchy–Binet).
// The usual cxx cyy - cxy² suffers from cancellation for long needles; a sum of squares does not.
//
// For the same reason the conic Σ2d⁻¹ is kept as two squares (its LDLᵀ factorisation), which is what blending
// evaluates. With C = cyy, the shear k = -cxy/C, and V = det/C:
//     dᵀ Σ2d⁻¹ d = u²/V + v²/C,   u = dx + k dy = (px - x₀) + k py,   v = dy,   x₀ = x + k y.
#pragma once

#include <algorithm>

#include "forward/slice_in_time.hpp"

namespace splat {

template <Motion motion, class Real>
struct EwaProjection {
    Real cam[3];  // μ(t) in camera axes
    Real inverse_z;
    Real normalised[2];           // normalised image coordinates x/z, y/z
    Real clamped_normalised[2];   // clamped to 1.3 × the field of view
    MaskOf<Real> not_clamped[2];  // the clamp had no effect
    Real jw[2][3];                // J W
    Real b[2][kAxes<motion>];
    Real cov_xx, cov_xy, cov_yy;
    Real shear, sheared_x, inverse_var_u, inverse_var_v;  // k, x₀, 1/V, 1/C
    Real pixel[2];
};

// Bounds of the clamp of x/z and y/z, on each side of the principal point. A side on which there is no image,
// as of a crop, has the width 0.
template <class Real>
struct FrustumLimits {
    ScalarOf<Real> low[2], high[2];
    explicit FrustumLimits(const CameraOf<ScalarOf<Real>>& c)
        : low{-margin(c.cx, c.fx), -margin(c.cy, c.fy)},
          high{margin(c.width - c.cx, c.fx), margin(c.height - c.cy, c.fy)} {}

private:
    static ScalarOf<Real> margin(ScalarOf<Real> pixels, ScalarOf<Real> focal) {
        return kFrustumMargin * std::max(pixels, ScalarOf<Real>(0)) / focal;
    }
};

// rotation: world to camera. offset: from the camera's position, world axes.
template <class Real>
SPLAT_INLINE void world_to_camera(const ScalarOf<Real> (&rotation)[3][3], const Real (&offset)[3],
                                  Real (&cam)[3]) {
    for (int i = 0; i < 3; ++i)
        cam[i] = Real(rotation[i][0]) * offset[0] + Real(rotation[i][1]) * offset[1] +
                 Real(rotation[i][2]) * offset[2];
}

template <Motion motion, class Real>
SPLAT_INLINE EwaProjection<motion, Real> project_ewa(const Slice<motion, Real>& g,
                                                     const CameraOf<ScalarOf<Real>>& c) {
    constexpr int kColumns = kAxes<motion>;
    const FrustumLimits<Real> limit(c);
    const ScalarOf<Real> focal[2] = {c.fx, c.fy}, centre[2] = {c.cx, c.cy};
    EwaProjection<motion, Real> p;
    world_to_camera<Real>(c.rotation, g.offset, p.cam);
    p.inverse_z = Real(1.f) / p.cam[2];
    for (int a = 0; a < 2; ++a) {
        p.normalised[a] = p.cam[a] * p.inverse_z;
        p.clamped_normalised[a] = clamp(p.normalised[a], limit.low[a], limit.high[a]);
        p.not_clamped[a] = (p.normalised[a] >= Real(limit.low[a])) & (p.normalised[a] <= Real(limit.high[a]));
        Real focal_over_z = p.inverse_z * Real(focal[a]);
        for (int j = 0; j < 3; ++j)
            p.jw[a][j] =
                focal_over_z * (Real(c.rotation[a][j]) - p.clamped_normalised[a] * Real(c.rotation[2][j]));
        for (int j = 0; j < kColumns; ++j)
            p.b[a][j] =
                p.jw[a][0] * g.factor[0][j] + p.jw[a][1] * g.factor[1][j] + p.jw[a][2] * g.factor[2][j];
        // From here on pixel centres are integers.
        p.pixel[a] = Real(focal[a]) * p.normalised[a] + Real(centre[a] - 0.5f);
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
    p.inverse_var_v = Real(1.f) / p.cov_yy;
    p.inverse_var_u = p.cov_yy / det;
    p.shear = -p.cov_xy * p.inverse_var_v;
    p.sheared_x = p.pixel[0] + p.shear * p.pixel[1];
    return p;
}

// Optical flow: how far mean2d moves in δ, in pixels, seen by the camera at that time
// (CameraOf::flow_camera). 0 where the mean would reach the near plane.
template <class Real>
struct Flow {
    Real pixel[2];
    Real later_cam[3], later_normalised[2], later_inverse_z;
    MaskOf<Real> valid;
};
template <Motion motion, class Real>
SPLAT_INLINE Flow<Real> flow_of(const Slice<motion, Real>& g, const EwaProjection<motion, Real>& p,
                                const CameraOf<ScalarOf<Real>>& c, scalar flow_dt, scalar near_plane) {
    Flow<Real> f;
    Real later[3], speed(0.f);
    for (int i = 0; i < 3; ++i) {
        later[i] = g.offset[i];
        if constexpr (kMoves<motion>) {
            later[i] += g.flow_velocity[i] * Real(flow_dt);
            speed += abs(g.flow_velocity[i]);
        }
        later[i] += Real(c.flow_camera.shift[i]);
    }
    world_to_camera<Real>(c.flow_camera.rotation, later, f.later_cam);
    f.valid = f.later_cam[2] > Real(near_plane);
    f.later_inverse_z = Real(1.f) / select(f.valid, f.later_cam[2], Real(1.f));
    // Where the camera stays, what stands still has no flow, not that of rounding.
    const MaskOf<Real> moves = f.valid & (speed > Real(c.flow_camera.moved ? -1.f : 0.f));
    const ScalarOf<Real> focal[2] = {c.fx, c.fy};
    for (int a = 0; a < 2; ++a) {
        f.later_normalised[a] = f.later_cam[a] * f.later_inverse_z;
        Real moved_by = Real(focal[a]) * (f.later_normalised[a] - p.normalised[a]);
        if (c.flow_camera.moved)
            moved_by += Real(c.flow_camera.focal_change[a]) * f.later_normalised[a] +
                        Real(c.flow_camera.centre_change[a]);
        f.pixel[a] = zero_unless(moves, moved_by);
    }
    return f;
}

}  // namespace splat
