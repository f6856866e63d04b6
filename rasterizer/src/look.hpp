// What a frame needs to know of sixteen Gaussians before colour, and the way back, each in float32 or, for a
// Gaussian whose rounding would show, in double (exact.hpp).
#pragma once

#include "project.hpp"

namespace splat {

// Where the rounding of sixteen Gaussians' geometry shows. R is good to 6e-8 of its largest entry, so
// - an axis of kLongPixels is 6e-5 pixels wrong at its end;
// - the way moved since μt is wrong by as much of what it would be if the axes were at their worst angle; a
//   tenth of that counts, for scenes whose unit of time is much longer than that of length would all be
//   caught; some of the lifetime counts as moved even at μt, where gradients still depend on the speed;
// - Σtt, and with it p(t), where its axes are kShortInTime of what they would be at that angle;
// - the way from the camera is good to 6e-8 of itself, the place on the screen so to 1e-7 of the focal
//   length: at kLongFocal pixels, a strong telephoto lens, images are 4e-4 wrong and gradients 2e-3 of the
//   largest.
inline constexpr scalar kLongPixels = 1000.f, kMotionShare = 0.1f, kLifetimeShare = 0.3f;
inline constexpr scalar kShortInTime = 1e-3f, kLongFocal = 16384.f;

template <Motion motion>
SPLAT_INLINE Mask rounding_shows(const Slice<motion, Float>& g, const Projection<motion, Float>& p,
                                 const Camera& c) {
    const scalar focal = std::max(c.fx, c.fy);
    const Float pixels_per_unit = abs(p.inverse_z) * Float(focal);
    Float reach = max(max(g.scale[0], g.scale[1]), g.scale[2]);
    Mask fine = Float(0.f) >= Float(0.f);
    if constexpr (motion == Motion::kFull) {
        Float in_time(0.f), in_space(0.f), tilt(0.f);
        for (int j = 0; j < 4; ++j) {
            in_time += g.scale[j] * abs(g.axes[3][j]);
            in_space += g.scale[j] * (abs(g.axes[0][j]) + abs(g.axes[1][j]) + abs(g.axes[2][j]));
            if (j < 3) tilt += g.axes[3][j] * g.axes[3][j];
        }
        const Float moved = (abs(g.dt) + Float(kLifetimeShare) * sqrt(g.var_t)) * g.inverse_var;
        reach += (in_time + in_space) * moved * Float(kMotionShare) + g.scale[3] * tilt * g.inverse_var;
        fine = in_time * g.inverse_var * Float(kShortInTime) <= Float(1.f);
    }
    // Asked this way round, so that what has overflowed is not fine.
    fine = fine & (reach * pixels_per_unit <= Float(kLongPixels));
    return Float(1.f) > select(fine, focal <= kLongFocal ? 1.f : 0.f, 0.f);
}

// A Gaussian as the camera sees it at its moment.
template <class Real>
struct Seen {
    enum Field {
        kX,
        kY,
        kIntercept,
        kLean,
        kInverseAcross,
        kInverseAlong,
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

template <Motion motion, class Real>
SPLAT_INLINE Seen<Real> seen_from(const Slice<motion, Real>& g, const Projection<motion, Real>& p,
                                  const CameraOf<ScalarOf<Real>>& c, const Settings& s) {
    Seen<Real> out;
    Real(&v)[Seen<Real>::kFields] = out.value;
    v[out.kX] = p.pixel[0], v[out.kY] = p.pixel[1];
    v[out.kIntercept] = p.intercept, v[out.kLean] = p.lean;
    v[out.kInverseAcross] = p.inverse_across, v[out.kInverseAlong] = p.inverse_along;
    v[out.kVarianceX] = p.cov_xx, v[out.kVarianceY] = p.cov_yy, v[out.kCovariance] = p.cov_xy;
    v[out.kDepth] = p.cam[2];
    v[out.kLog2Marginal] = g.log2_marginal;
    for (int i = 0; i < 3; ++i) v[out.kOffset + i] = g.offset[i];
    v[out.kVarianceT] = motion == Motion::kStatic ? Real(0.f) : g.var_t;
    v[out.kFlow] = v[out.kFlow + 1] = Real(0.f);
    if constexpr (motion == Motion::kFull) {
        if (s.flow) {
            const Flow<Real> flow = flow_of<Real>(g, p, c, s.flow_dt, s.near_plane);
            v[out.kFlow] = flow.pixel[0], v[out.kFlow + 1] = flow.pixel[1];
        }
    }
    return out;
}

// The lanes in `wanted`, a bit each.
template <Motion motion>
SPLAT_INLINE Seen<Float> look(const Stored<motion, Float>& stored, unsigned wanted, const Camera& c,
                              const CameraOf<double>& exact, const Settings& s) {
    const Slice<motion, Float> g = slice_in_time(stored, c);
    const Projection<motion, Float> p = project(g, c);
    Seen<Float> out = seen_from(g, p, c, s);
    for (unsigned lanes = bits(rounding_shows(g, p, c)) & wanted; lanes; lanes &= lanes - 1) [[unlikely]] {
        const int l = __builtin_ctz(lanes);
        const Slice<motion, double> exact_g = slice_in_time(stored.lane(l), exact);
        const Seen<double> better = seen_from(exact_g, project(exact_g, exact), exact, s);
        for (int k = 0; k < Seen<Float>::kFields; ++k) set_lane(out.value[k], l, better.value[k]);
    }
    return out;
}

// ∂L/∂ what blending and colour have collected of a Gaussian.
template <class Real>
struct Collected {
    Real slot[16];     // SlotField
    Real d_offset[3];  // of the camera's centre to μ(t), by way of the colour
    Real d_dt;         // of t - μt, likewise
};

// ∂L/∂ the stored parameters, and what a view reports besides.
template <class Real>
struct Carried {
    enum Field { kMean, kLogScale = 4, kLeft = 8, kRight = 12, kPixel = 16, kOffset = 18, kFields = 21 };
    Real value[kFields];
};

template <Motion motion, class Real>
SPLAT_INLINE Carried<Real> carry_back(const Slice<motion, Real>& g, const Projection<motion, Real>& p,
                                      const Collected<Real>& in, const CameraOf<ScalarOf<Real>>& c,
                                      const Settings& s) {
    const Real(&slot)[16] = in.slot;
    const Real half(0.5f);
    // blending: moments of the pixels across and along the ellipse's axis → its place and shape
    ProjectionGradient<Real> d;
    const Real push = slot[kSlotAcross] * p.inverse_across;
    d.pixel[0] = push;
    d.pixel[1] = p.lean * push + slot[kSlotAlong] * p.inverse_along;
    d.across = half * slot[kSlotAcross2] * p.inverse_across * p.inverse_across;
    d.along = half * slot[kSlotAlong2] * p.inverse_along * p.inverse_along;
    d.lean = -(slot[kSlotBoth] * p.inverse_across);
    Carried<Real> out;
    for (int i = 0; i < 2; ++i) out.value[out.kPixel + i] = d.pixel[i];

    int extra = kSlotExtra;
    d.depth = s.depth ? slot[extra++] : Real(0.f);
    SliceGradient<motion, Real> d_slice;
    Real d_mean_flow[3] = {Real(0.f), Real(0.f), Real(0.f)};
    for (auto& v : d_slice.velocity) v = Real(0.f);
    if (s.flow) {
        if constexpr (motion == Motion::kFull) {
            const Real d_flow[2] = {slot[extra], slot[extra + 1]};
            flow_backward<Real>(flow_of<Real>(g, p, c, s.flow_dt, s.near_plane), c, s.flow_dt, d_flow,
                                d.pixel, d_mean_flow, d_slice.velocity);
        }
        extra += 2;
    }
    const Real d_mean_t_stats = s.stats ? slot[extra] : Real(0.f);
    d_slice.var_t = s.stats ? slot[extra + 1] : Real(0.f);

    project_backward(p, g, c, d, d_slice.mean, d_slice.factor);
    for (int k = 0; k < 3; ++k) d_slice.mean[k] += in.d_offset[k] + d_mean_flow[k];
    d_slice.log_marginal = slot[kSlotPower];
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
    for (int i = 0; i < 3; ++i) out.value[out.kOffset + i] = g.offset[i];
    return out;
}

}  // namespace splat
