// Backward of forward/project.hpp: from a splat's summed gradients to the gradient of the stored parameters.
#pragma once

#include "backward/project_ewa_backward.hpp"
#include "backward/slice_in_time_backward.hpp"
#include "forward/project.hpp"

namespace splat {

// What blending and colour give to a Gaussian's gradient.
template <class Real>
struct SplatGradient {
    Real gradient[16];  // by GradientField, summed over its intersections
    Real d_offset[3];   // of μ(t) - camera position, through the colour
    Real d_dt;          // of t - μt, through the colour
};

// ∂L/∂ the stored parameters and mean2d; with them the offset μ(t) - camera position.
template <class Real>
struct GaussianGradient {
    enum Field {
        kMean,
        kLogScale = 4,
        kLeft = 8,
        kRight = 12,
        kVelocity = 16,
        kDrift = 19,
        kMean2d = 22,
        kOffset = 24,
        kFields = 27
    };
    Real value[kFields];
};

// Through blending's moments, flow, EWA projection and slice.
template <Motion motion, class Real>
SPLAT_INLINE GaussianGradient<Real> project_backward(const Slice<motion, Real>& g,
                                                     const EwaProjection<motion, Real>& p,
                                                     const SplatGradient<Real>& in,
                                                     const CameraOf<ScalarOf<Real>>& c, const Settings& s) {
    const Real(&gradient)[16] = in.gradient;
    const Real half(0.5f);
    // From the moments of u and v to mean2d and the conic.
    EwaProjectionGradient<Real> d;
    const Real d_u = gradient[kMomentU] * p.inverse_var_u;
    d.pixel[0] = d_u;
    d.pixel[1] = p.shear * d_u + gradient[kMomentV] * p.inverse_var_v;
    d.var_u = half * gradient[kMomentUU] * p.inverse_var_u * p.inverse_var_u;
    d.var_v = half * gradient[kMomentVV] * p.inverse_var_v * p.inverse_var_v;
    d.shear = -(gradient[kMomentUV] * p.inverse_var_u);
    GaussianGradient<Real> out;
    for (int i = 0; i < 2; ++i) out.value[out.kMean2d + i] = d.pixel[i];

    int extra = kGradExtra;
    d.depth = s.depth ? gradient[extra++] : Real(0.f);
    SliceGradient<motion, Real> d_slice;
    Real d_mean_flow[3] = {Real(0.f), Real(0.f), Real(0.f)};
    for (auto& v : d_slice.velocity) v = Real(0.f);
    if (s.flow) {
        const Real d_flow[2] = {gradient[extra], gradient[extra + 1]};
        flow_backward<Real>(flow_of(g, p, c, s.flow_dt, s.near_plane), c, s.flow_dt, d_flow, d.pixel,
                            d_mean_flow, d_slice.velocity);
        extra += 2;
    }
    const Real d_mean_t_stats = s.stats ? gradient[extra] : Real(0.f);
    d_slice.var_t = s.stats ? gradient[extra + 1] : Real(0.f);

    project_ewa_backward(p, g, c, d, d_slice.mean, d_slice.factor);
    for (int k = 0; k < 3; ++k) d_slice.mean[k] += in.d_offset[k] + d_mean_flow[k];
    d_slice.log_marginal = gradient[kGradLogAlpha];
    d_slice.dt = in.d_dt;
    StoredGradient<motion, Real> stored = slice_in_time_backward(g, d_slice);
    if constexpr (motion != Motion::kStatic) stored.mean[3] += d_mean_t_stats;
    for (int i = 0; i < (motion == Motion::kStatic ? 3 : 4); ++i) {
        out.value[out.kMean + i] = stored.mean[i];
        out.value[out.kLogScale + i] = stored.log_scale[i];
    }
    for (int i = 0; i < 4; ++i) {
        out.value[out.kLeft + i] = stored.quat_left[i];
        if constexpr (motion == Motion::kFull) out.value[out.kRight + i] = stored.quat_right[i];
    }
    for (int i = 0; i < 3; ++i) {
        if constexpr (motion == Motion::kSeparable) {
            out.value[out.kVelocity + i] = stored.velocity[i];
            out.value[out.kDrift + i] = stored.drift[i];
        }
        out.value[out.kOffset + i] = g.offset[i];
    }
    return out;
}

}  // namespace splat
