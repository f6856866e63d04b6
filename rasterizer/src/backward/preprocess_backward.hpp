// Backward of forward/preprocess.hpp: from the gradients of intersections to those of the stored parameters.
//
// Sixteen visible Gaussians at a time, in order of id: their intersections' gradients are summed in a fixed
// order, then go back through colour, projection and slice. SH coefficients get a compact ColorGradient
// (sh_backward.hpp).
#pragma once

#include "backward/next_lanes.hpp"
#include "backward/project_backward.hpp"
#include "backward/shared_motion_backward.hpp"
#include "forward/preprocess.hpp"
#include "view_state.hpp"

namespace splat {

// What a view reports of its visible Gaussians, in order of id: arrays of `visible` rows.
struct ViewGradient {
    int32_t* visible;
    scalar* mean2d;  // [V, 2] ∂L/∂mean2d, pixels
    scalar* mean_t;  // [V] ∂L/∂μt of this view alone
    scalar* radius;  // [V] of the splat, pixels
    ColorGradient* color;
};

SPLAT_INLINE void add_to_rows3(scalar* rows, const uint32_t* ids, int count, const Float* column) {
    alignas(64) scalar lane[3][16];
    for (int k = 0; k < 3; ++k) column[k].store(lane[k]);
    for (int l = 0; l < count; ++l)
        for (int k = 0; k < 3; ++k) rows[3 * static_cast<size_t>(ids[l]) + k] += lane[k][l];
}

// Sums the intersection gradients of sixteen Gaussians: GradientField k of all is total[k].
SPLAT_INLINE void sum_intersection_gradients(const ViewState& view, uint32_t splat_index, int count,
                                             Float (&total)[16]) {
    for (int l = 0; l < kLanes; ++l) {
        total[l] = 0.f;
        if (l >= count) continue;
        const ViewState::GradientRange range = view.gradient_range[splat_index + l];
        for (uint32_t k = 0; k < range.count; ++k)
            total[l] += Float::load(view.intersection_gradients[range.begin + k].value);
    }
    transpose(total);
}

// The backward pass of sixteen Gaussians: splats splat_index .. splat_index + count - 1. next: those to
// prefetch meanwhile.
template <Motion motion, int order>
inline void preprocess_backward_lanes(const ViewState& view, const Parameters& p, uint32_t splat_index,
                                      int count, uint32_t first_row, const NextLanes& next,
                                      const ParameterGradients& out, const ViewGradient& view_out,
                                      const scalar* trajectories, scalar* d_trajectories) {
    constexpr int kRow = motion == Motion::kStatic ? 3 : 4;
    const Settings& s = view.settings;
    const Splat* splats = &view.splats[splat_index];
    uint32_t ids[kLanes];
    for (int l = 0; l < kLanes; ++l) ids[l] = splats[std::min(l, count - 1)].id;
    Float gradient[16];
    sum_intersection_gradients(view, splat_index, count, gradient);

    next.intersection_gradients(0);

    SharedMotion moved;
    const Stored<motion, Float> stored = Stored<motion, Float>::load(p, ids, &moved);
    const Slice<motion, Float> g = slice_in_time(stored, view.camera);
    next.rows(p.mean, kRow);
    next.rows(p.log_scale, kRow);
    const EwaProjection<motion, Float> projection = project_ewa(g, view.camera);
    next.intersection_gradients(1);

    // Colour, by its Jacobian.
    SplatGradient<Float> in;
    Float d_rgb[3], jacobian[16];
    for (int k = 0; k < 16; ++k) in.gradient[k] = gradient[k];
    for (int l = 0; l < kLanes; ++l)
        jacobian[l] =
            Float::load(&view.color_jacobian[splat_index + std::min(l, count - 1)].wrt_offset[0][0]);
    transpose(jacobian);
    for (int k = 0; k < 3; ++k) d_rgb[k] = gradient[kGradR + k] * jacobian[12 + k];
    for (int i = 0; i < 3; ++i)
        in.d_offset[i] = d_rgb[0] * jacobian[i] + d_rgb[1] * jacobian[3 + i] + d_rgb[2] * jacobian[6 + i];
    in.d_dt = 0.f;
    if constexpr (order > 0)
        in.d_dt = d_rgb[0] * jacobian[9] + d_rgb[1] * jacobian[10] + d_rgb[2] * jacobian[11];
    if (s.detached) [[unlikely]]
        in.d_offset[0] = in.d_offset[1] = in.d_offset[2] = in.d_dt = Float(0.f);
    next.color_jacobians();

    // Projection, slice in time, activations.
    GaussianGradient<Float> d_gaussian = project_backward(g, projection, in, view.camera, s);
    for (unsigned lanes = bits(needs_double(g, projection, view.camera)) & ((1u << count) - 1); lanes;
         lanes &= lanes - 1) [[unlikely]] {
        const int l = __builtin_ctz(lanes);
        SplatGradient<double> in_double;
        for (int k = 0; k < 16; ++k) in_double.gradient[k] = lane_of(in.gradient[k], l);
        for (int k = 0; k < 3; ++k) in_double.d_offset[k] = lane_of(in.d_offset[k], l);
        in_double.d_dt = lane_of(in.d_dt, l);
        const Slice<motion, double> g_double = slice_in_time(stored.lane(l), view.camera_double);
        const GaussianGradient<double> out_double = project_backward(
            g_double, project_ewa(g_double, view.camera_double), in_double, view.camera_double, s);
        for (int k = 0; k < GaussianGradient<Float>::kFields; ++k)
            set_lane(d_gaussian.value[k], l, out_double.value[k]);
    }
    next.rows(p.quat_left, 4);
    if constexpr (motion == Motion::kFull) next.rows(p.quat_right, 4);
    StoredGradient<motion, Float> d_stored;
    for (int k = 0; k < 4; ++k) {
        d_stored.mean[k] = d_gaussian.value[d_gaussian.kMean + k];
        d_stored.log_scale[k] = d_gaussian.value[d_gaussian.kLogScale + k];
        d_stored.quat_left[k] = d_gaussian.value[d_gaussian.kLeft + k];
        d_stored.quat_right[k] = d_gaussian.value[d_gaussian.kRight + k];
    }
    for (int k = 0; k < 3; ++k) {
        d_stored.velocity[k] = d_gaussian.value[d_gaussian.kVelocity + k];
        d_stored.drift[k] = d_gaussian.value[d_gaussian.kDrift + k];
    }
    const Float d_mean2d[2] = {d_gaussian.value[d_gaussian.kMean2d],
                               d_gaussian.value[d_gaussian.kMean2d + 1]};
    const Float offset[3] = {d_gaussian.value[d_gaussian.kOffset], d_gaussian.value[d_gaussian.kOffset + 1],
                             d_gaussian.value[d_gaussian.kOffset + 2]};
    Float phase(0.f);
    if constexpr (order > 0) phase = fourier_phase(stored.mean[3], view.camera_double, s.duration);
    const ViewDirection direction = view_direction(offset, phase);
    // ∂ ln σ(o)/∂o = 1 - σ(o), and 0 beyond ±80, where exp is clamped.
    const Float d_opacity = zero_unless(Float(kLargestExponent) >= abs(stored.opacity_logit),
                                        gradient[kGradLogAlpha] / (Float(1.f) + exp(stored.opacity_logit)));

    if constexpr (motion == Motion::kStatic) {
        add_to_rows3(out.mean, ids, count, d_stored.mean);
        add_to_rows3(out.log_scale, ids, count, d_stored.log_scale);
    } else {
        add_to_rows4(out.mean, ids, count, d_stored.mean);
        add_to_rows4(out.log_scale, ids, count, d_stored.log_scale);
    }
    if constexpr (motion == Motion::kSeparable)
        if (out.weights) {
            Float before[4], d_turn[3];
            load_rows4(p.quat_left, ids, before);
            turn_quaternion_backward(moved, before, d_stored.quat_left, d_turn);
            const Float d[kTrajectoryValues] = {d_stored.mean[0],  d_stored.mean[1],  d_stored.mean[2],
                                                d_turn[0],         d_turn[1],         d_turn[2],
                                                d_stored.drift[0], d_stored.drift[1], d_stored.drift[2]};
            shared_motion_backward(p, ids, count, s.flow, trajectories, d, out.weights, d_trajectories);
        }
    add_to_rows4(out.quat_left, ids, count, d_stored.quat_left);
    if constexpr (motion == Motion::kFull) add_to_rows4(out.quat_right, ids, count, d_stored.quat_right);
    if constexpr (motion == Motion::kSeparable)
        if (out.velocity) add_to_rows3(out.velocity, ids, count, d_stored.velocity);
    next.rows_to_write(out.mean, kRow);
    next.rows_to_write(out.log_scale, kRow);
    alignas(64) scalar lane[16];
    d_opacity.store(lane);
    for (int l = 0; l < count; ++l) out.opacity_logit[ids[l]] += lane[l];

    next.rows_to_write(out.quat_left, 4);
    if constexpr (motion == Motion::kFull) next.rows_to_write(out.quat_right, 4);
    Cosines<2> cosines(direction.phase);
    Float row[16] = {d_rgb[0],
                     d_rgb[1],
                     d_rgb[2],
                     direction.direction[0],
                     direction.direction[1],
                     direction.direction[2],
                     cosines.value[1],
                     cosines.value[2],
                     d_mean2d[0],
                     d_mean2d[1],
                     motion == Motion::kStatic ? Float(0.f) : d_stored.mean[3],
                     0.f,
                     0.f,
                     0.f,
                     0.f,
                     0.f};
    transpose(row);
    for (int l = 0; l < count; ++l) {
        scalar value[16];
        row[l].store(value);
        const size_t v = first_row + l;
        std::memcpy(&view_out.color[v], value, sizeof(ColorGradient));
        view_out.visible[v] = static_cast<int32_t>(ids[l]);
        view_out.mean2d[2 * v] = value[8];
        view_out.mean2d[2 * v + 1] = value[9];
        view_out.mean_t[v] = value[10];
        view_out.radius[v] = splats[l].radius;
    }
}

template <Motion motion, int order>
inline void preprocess_backward(ViewState& view, const Parameters& p, const ParameterGradients& out,
                                const ViewGradient& view_out) {
    StageTimer timer(view, kStagePreprocessBackward);
    const int chunks = static_cast<int>(view.chunk_count.size());
    // Every chunk sums the gradient of the trajectories on its own, so that the order is that of the
    // Gaussians.
    const int stride = trajectory_stride(p), values = out.weights ? kTrajectoryValues * stride : 0;
    std::vector<scalar> d_trajectories(static_cast<size_t>(chunks) * values), trajectories(values);
    for (int c = 0; c < kTrajectoryValues && values; ++c)
        for (int k = 0; k < p.trajectory_count; ++k)
            trajectories[c * stride + k] = p.trajectories[kTrajectoryColumns * k + c];
#pragma omp parallel for schedule(dynamic, 1) num_threads(view.settings.threads)
    for (int c = 0; c < chunks; ++c) {
        const uint32_t splat_index = static_cast<uint32_t>(c) * kChunk, count = view.chunk_count[c];
        for (uint32_t i = 0; i < count; i += kLanes) {
            const int left = static_cast<int>(count - i);
            preprocess_backward_lanes<motion, order>(
                view, p, splat_index + i, std::min(kLanes, left), view.chunk_first[c] + i,
                NextLanes(view, splat_index + i + kLanes, left - kLanes), out, view_out, trajectories.data(),
                d_trajectories.data() + static_cast<size_t>(c) * values);
        }
    }
    for (int chunk = 0; chunk < chunks && values; ++chunk)
        for (int c = 0; c < kTrajectoryValues; ++c)
            for (int k = 0; k < p.trajectory_count; ++k)
                out.trajectories[kTrajectoryColumns * k + c] +=
                    d_trajectories[static_cast<size_t>(chunk) * values + c * stride + k];
}

}  // namespace splat
