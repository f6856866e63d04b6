// Backward of stages 1 to 3: each visible Gaussian's slots are summed in a fixed order and carried back
// through colour, projection and the slice in time to the stored parameters, sixteen Gaussians at a time in
// order of id.
#pragma once

#include "frame.hpp"
#include "prepare.hpp"

namespace splat {

// What one view says of its visible Gaussians, in order of id; arrays of `visible` rows. Null: not wanted.
struct ViewGradient {
    int32_t* id;
    float* mean2d;  // [V, 2] ∂L/∂ the mean's pixel position
    float* mean_t;  // [V] ∂L/∂μt of this view alone
    float* radius;  // [V] pixels
    ColorGradient* color;
};

SPLAT_INLINE void add_to_rows3(float* rows, const uint32_t* ids, int count, const Float (&column)[4]) {
    alignas(64) float lane[3][16];
    for (int k = 0; k < 3; ++k) column[k].store(lane[k]);
    for (int l = 0; l < count; ++l)
        for (int k = 0; k < 3; ++k) rows[3 * static_cast<size_t>(ids[l]) + k] += lane[k][l];
}

// The slots of sixteen Gaussians, summed: field k of all in total[k].
SPLAT_INLINE void sum_slots(const Frame& f, uint32_t place, int count, Float (&total)[16]) {
    for (int l = 0; l < kLanes; ++l) {
        total[l] = 0.f;
        if (l >= count) continue;
        const Frame::SlotRange range = f.slot_range[place + l];
        for (uint32_t k = 0; k < range.count; ++k) total[l] += Float::load(f.slots[range.begin + k].value);
    }
    transpose(total);
}

template <Motion motion, int order>
inline void backward_sixteen(const Frame& f, const Parameters& p, uint32_t place, int count,
                             uint32_t first_row, const ParameterGradients& out,
                             const ViewGradient& view_out) {
    const Settings& s = f.settings;
    const Splat* splats = &f.staged[place];
    uint32_t ids[kLanes];
    for (int l = 0; l < kLanes; ++l) ids[l] = splats[std::min(l, count - 1)].id;
    Float slot[16];
    sum_slots(f, place, count, slot);

    const Stored<motion> stored = Stored<motion>::load(p, ids);
    const Slice<motion> g = slice_in_time(stored, s.time);
    const Projection<motion> q = project(g, f.camera);

    // blending: moments of the pixel offsets → pixel position and conic
    ProjectionGradient d;
    d.pixel[0] = q.conic_xx * slot[kSlotX] + q.conic_xy * slot[kSlotY];
    d.pixel[1] = q.conic_yy * slot[kSlotY] + q.conic_xy * slot[kSlotX];
    d.conic_xx = Float(-0.5f) * slot[kSlotXX];
    d.conic_xy = -slot[kSlotXY];
    d.conic_yy = Float(-0.5f) * slot[kSlotYY];
    const Float d_pixel[2] = {d.pixel[0], d.pixel[1]};

    // colour: through its slopes; the coefficients' own gradient is left as a ColorGradient
    Float offset[3], d_rgb[3], d_offset[3], d_dt(0.f), dt(0.f), slope[16];
    for (int l = 0; l < kLanes; ++l)
        slope[l] = Float::load(&f.color_slope[place + std::min(l, count - 1)].by_offset[0][0]);
    transpose(slope);
    for (int k = 0; k < 3; ++k) {
        offset[k] = g.mean[k] - Float(f.camera.position[k]);
        d_rgb[k] = slot[kSlotR + k] * slope[12 + k];
    }
    for (int i = 0; i < 3; ++i)
        d_offset[i] = d_rgb[0] * slope[i] + d_rgb[1] * slope[3 + i] + d_rgb[2] * slope[6 + i];
    if constexpr (order > 0) d_dt = d_rgb[0] * slope[9] + d_rgb[1] * slope[10] + d_rgb[2] * slope[11];
    if constexpr (motion != Motion::kStatic) dt = g.dt;
    const Viewing view = viewing(offset, dt, s.duration);

    // extras
    int extra = kSlotExtra;
    d.depth = s.depth ? slot[extra++] : Float(0.f);
    SliceGradient<motion> d_slice;
    Float d_mean_flow[3] = {0.f, 0.f, 0.f};
    for (auto& v : d_slice.velocity) v = 0.f;
    if (s.flow) {
        if constexpr (motion == Motion::kFull) {
            const Float d_flow[2] = {slot[extra], slot[extra + 1]};
            flow_backward(flow_of(g, q, f.camera, s.flow_dt, s.near_plane), f.camera, s.flow_dt, d_flow,
                          d.pixel, d_mean_flow, d_slice.velocity);
        }
        extra += 2;
    }
    const Float d_mean_t_stats = s.stats ? slot[extra] : Float(0.f);
    d_slice.var_t = s.stats ? slot[extra + 1] : Float(0.f);

    // projection, slice in time, activations
    project_backward(q, g, f.camera, d, d_slice.mean, d_slice.factor);
    for (int k = 0; k < 3; ++k) d_slice.mean[k] += d_offset[k] + d_mean_flow[k];
    d_slice.log_marginal = slot[kSlotPower];
    d_slice.dt = d_dt;
    StoredGradient<motion> d_stored = slice_in_time_backward(g, d_slice);
    const Float d_opacity =
        slot[kSlotPower] / (Float(1.f) + exp(stored.opacity_logit));  // ∂ ln σ(o)/∂o = 1 - σ(o)

    if constexpr (motion == Motion::kStatic) {
        add_to_rows3(out.mean, ids, count, d_stored.mean);
        add_to_rows3(out.log_scale, ids, count, d_stored.log_scale);
    } else {
        d_stored.mean[3] += d_mean_t_stats;
        add_to_rows4(out.mean, ids, count, d_stored.mean);
        add_to_rows4(out.log_scale, ids, count, d_stored.log_scale);
    }
    add_to_rows4(out.quat_left, ids, count, d_stored.quat_left);
    if constexpr (motion == Motion::kFull) add_to_rows4(out.quat_right, ids, count, d_stored.quat_right);
    alignas(64) float lane[16];
    d_opacity.store(lane);
    for (int l = 0; l < count; ++l) out.opacity_logit[ids[l]] += lane[l];

    Cosines<2> cosines(view.turns);
    Float row[16] = {d_rgb[0],
                     d_rgb[1],
                     d_rgb[2],
                     view.direction[0],
                     view.direction[1],
                     view.direction[2],
                     cosines.value[1],
                     cosines.value[2],
                     d_pixel[0],
                     d_pixel[1],
                     motion == Motion::kStatic ? Float(0.f) : d_stored.mean[3],
                     0.f,
                     0.f,
                     0.f,
                     0.f,
                     0.f};
    transpose(row);
    for (int l = 0; l < count; ++l) {
        float value[16];
        row[l].store(value);
        const size_t v = first_row + l;
        std::memcpy(&view_out.color[v], value, sizeof(ColorGradient));
        view_out.id[v] = static_cast<int32_t>(ids[l]);
        view_out.mean2d[2 * v] = value[8];
        view_out.mean2d[2 * v + 1] = value[9];
        view_out.mean_t[v] = value[10];
        view_out.radius[v] = splats[l].radius;
    }
}

template <Motion motion, int order>
inline void gaussian_backward(Frame& f, const Parameters& p, const ParameterGradients& out,
                              const ViewGradient& view_out) {
    StageTimer timer(f, kStageGaussianBackward);
    const int chunks = static_cast<int>(f.chunk_count.size());
#pragma omp parallel for schedule(dynamic, 1) num_threads(f.settings.threads)
    for (int c = 0; c < chunks; ++c) {
        const uint32_t place = static_cast<uint32_t>(c) * kChunk, count = f.chunk_count[c];
        for (uint32_t i = 0; i < count; i += kLanes)
            backward_sixteen<motion, order>(f, p, place + i,
                                            static_cast<int>(std::min<uint32_t>(kLanes, count - i)),
                                            f.chunk_first[c] + i, out, view_out);
    }
}

}  // namespace splat
