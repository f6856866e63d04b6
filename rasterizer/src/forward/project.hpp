// Slices and projects sixteen Gaussians in float32, and in double those whose rounding would be visible.
#pragma once

#include "forward/project_ewa.hpp"

namespace splat {

// Where float32 is not accurate enough. The rotation R has an error of 6e-8 of its largest entry, so
// - an axis of kMaxExtentPixels pixels is off by 6e-5 pixels at its end.
// - The displacement h (t - μt) is off by 6e-8 of its worst case over the axes' directions. It is weighted by
//   kMotionWeight, or all Gaussians would need double in scenes whose unit of time is much longer than that
//   of length. kLifetimeWeight standard deviations are added to |t - μt|: gradients depend on h at μt too.
//   A velocity that is stored has no worst case: its displacement counts in full.
// - Σtt, and p(t) with it, is inaccurate where the axes are kMinTimeRatio of their worst case in time.
// - μ(t) - camera has an error of 6e-8 of itself, so mean2d has one of 1e-7 focal lengths. With kMaxFocal
//   pixels, a strong telephoto lens, images are off by 4e-4, gradients by 2e-3 of the largest.
inline constexpr scalar kMaxExtentPixels = 1000.f, kMotionWeight = 0.1f, kLifetimeWeight = 0.3f;
inline constexpr scalar kMinTimeRatio = 1e-3f, kMaxFocal = 16384.f;

template <Motion motion>
SPLAT_INLINE Mask needs_double(const Slice<motion, Float>& g, const EwaProjection<motion, Float>& p,
                               const Camera& c) {
    const scalar focal = std::max(c.fx, c.fy);
    const Float pixels_per_unit = abs(p.inverse_z) * Float(focal);
    Float extent = max(max(g.scale[0], g.scale[1]), g.scale[2]);
    Mask accurate = Float(0.f) >= Float(0.f);
    if constexpr (motion == Motion::kFull) {
        Float time_extent(0.f), space_extent(0.f), time_tilt2(0.f);
        for (int j = 0; j < 4; ++j) {
            time_extent += g.scale[j] * abs(g.axes[3][j]);
            space_extent += g.scale[j] * (abs(g.axes[0][j]) + abs(g.axes[1][j]) + abs(g.axes[2][j]));
            if (j < 3) time_tilt2 += g.axes[3][j] * g.axes[3][j];
        }
        const Float time_shift = (abs(g.dt) + Float(kLifetimeWeight) * sqrt(g.var_t)) * g.inverse_var;
        extent += (time_extent + space_extent) * time_shift * Float(kMotionWeight) +
                  g.scale[3] * time_tilt2 * g.inverse_var;
        accurate = time_extent * g.inverse_var * Float(kMinTimeRatio) <= Float(1.f);
    }
    if constexpr (motion == Motion::kSeparable) {
        const Float speed = max(max(abs(g.velocity[0]), abs(g.velocity[1])), abs(g.velocity[2]));
        extent += speed * abs(g.dt);
    }
    // Written so that NaN and infinity count as not accurate.
    accurate = accurate & (extent * pixels_per_unit <= Float(kMaxExtentPixels));
    return Float(1.f) > select(accurate, focal <= kMaxFocal ? 1.f : 0.f, 0.f);
}

// A Gaussian projected to the screen at time t. kInverseVarU, kInverseVarV: 1/V and 1/C of project_ewa.hpp.
template <class Real>
struct ProjectedGaussian {
    enum Field {
        kX,
        kY,
        kShearedX,
        kShear,
        kInverseVarU,
        kInverseVarV,
        kVarianceX,
        kVarianceY,
        kCovariance,
        kDepth,
        kLog2Marginal,
        kOffset,
        kVarianceT = kOffset + 3,
        kFlow,
        kFields = kFlow + 2
    };
    Real value[kFields];
};

// Collects the outputs of slice and projection.
template <Motion motion, class Real>
SPLAT_INLINE ProjectedGaussian<Real> projected_gaussian(const Slice<motion, Real>& g,
                                                        const EwaProjection<motion, Real>& p,
                                                        const CameraOf<ScalarOf<Real>>& c,
                                                        const Settings& s) {
    ProjectedGaussian<Real> out;
    Real(&v)[ProjectedGaussian<Real>::kFields] = out.value;
    v[out.kX] = p.pixel[0], v[out.kY] = p.pixel[1];
    v[out.kShearedX] = p.sheared_x, v[out.kShear] = p.shear;
    v[out.kInverseVarU] = p.inverse_var_u, v[out.kInverseVarV] = p.inverse_var_v;
    v[out.kVarianceX] = p.cov_xx, v[out.kVarianceY] = p.cov_yy, v[out.kCovariance] = p.cov_xy;
    v[out.kDepth] = p.cam[2];
    v[out.kLog2Marginal] = g.log2_marginal;
    for (int i = 0; i < 3; ++i) v[out.kOffset + i] = g.offset[i];
    v[out.kVarianceT] = motion == Motion::kStatic ? Real(0.f) : g.var_t;
    v[out.kFlow] = v[out.kFlow + 1] = Real(0.f);
    if (s.flow) {
        const Flow<Real> flow = flow_of(g, p, c, s.flow_dt, s.near_plane);
        v[out.kFlow] = flow.pixel[0], v[out.kFlow + 1] = flow.pixel[1];
    }
    return out;
}

// Slices and projects. lanes: a bit for each lane in use.
template <Motion motion>
SPLAT_INLINE ProjectedGaussian<Float> project(const Stored<motion, Float>& stored, unsigned lanes,
                                              const Camera& c, const CameraOf<double>& camera_double,
                                              const Settings& s) {
    const Slice<motion, Float> g = slice_in_time(stored, c);
    const EwaProjection<motion, Float> p = project_ewa(g, c);
    ProjectedGaussian<Float> out = projected_gaussian(g, p, c, s);
    for (unsigned left = bits(needs_double(g, p, c)) & lanes; left; left &= left - 1) [[unlikely]] {
        const int l = __builtin_ctz(left);
        const Slice<motion, double> g_double = slice_in_time(stored.lane(l), camera_double);
        const ProjectedGaussian<double> in_double =
            projected_gaussian(g_double, project_ewa(g_double, camera_double), camera_double, s);
        for (int k = 0; k < ProjectedGaussian<Float>::kFields; ++k)
            set_lane(out.value[k], l, in_double.value[k]);
    }
    return out;
}

}  // namespace splat
