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
    scalar* mean2d;  // [V, 2] ∂L/∂ the mean's pixel position
    scalar* mean_t;  // [V] ∂L/∂μt of this view alone
    scalar* radius;  // [V] pixels
    ColorGradient* color;
};

SPLAT_INLINE void add_to_rows3(scalar* rows, const uint32_t* ids, int count, const Float (&column)[4]) {
    alignas(64) scalar lane[3][16];
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

    const Stored<motion, Float> stored = Stored<motion, Float>::load(p, ids);
    const Slice<motion, Float> g = slice_in_time(stored, f.camera);
    const Projection<motion, Float> q = project(g, f.camera);

    // colour: through its slopes; the coefficients' own gradient is left as a ColorGradient
    Collected<Float> in;
    Float d_rgb[3], slope[16];
    for (int k = 0; k < 16; ++k) in.slot[k] = slot[k];
    for (int l = 0; l < kLanes; ++l)
        slope[l] = Float::load(&f.color_slope[place + std::min(l, count - 1)].by_offset[0][0]);
    transpose(slope);
    for (int k = 0; k < 3; ++k) d_rgb[k] = slot[kSlotR + k] * slope[12 + k];
    for (int i = 0; i < 3; ++i)
        in.d_offset[i] = d_rgb[0] * slope[i] + d_rgb[1] * slope[3 + i] + d_rgb[2] * slope[6 + i];
    in.d_dt = 0.f;
    if constexpr (order > 0) in.d_dt = d_rgb[0] * slope[9] + d_rgb[1] * slope[10] + d_rgb[2] * slope[11];

    // projection, slice in time, activations
    Carried<Float> back = carry_back(g, q, in, f.camera, s);
    for (unsigned lanes = bits(rounding_shows(g, q, f.camera)) & ((1u << count) - 1); lanes;
         lanes &= lanes - 1) [[unlikely]] {
        const int l = __builtin_ctz(lanes);
        Collected<double> exact_in;
        for (int k = 0; k < 16; ++k) exact_in.slot[k] = lane_of(in.slot[k], l);
        for (int k = 0; k < 3; ++k) exact_in.d_offset[k] = lane_of(in.d_offset[k], l);
        exact_in.d_dt = lane_of(in.d_dt, l);
        const Slice<motion, double> exact_g = slice_in_time(stored.lane(l), f.exact_camera);
        const Carried<double> better =
            carry_back(exact_g, project(exact_g, f.exact_camera), exact_in, f.exact_camera, s);
        for (int k = 0; k < Carried<Float>::kFields; ++k) set_lane(back.value[k], l, better.value[k]);
    }
    StoredGradient<motion, Float> d_stored;
    for (int k = 0; k < 4; ++k) {
        d_stored.mean[k] = back.value[back.kMean + k];
        d_stored.log_scale[k] = back.value[back.kLogScale + k];
        d_stored.quat_left[k] = back.value[back.kLeft + k];
        d_stored.quat_right[k] = back.value[back.kRight + k];
    }
    const Float d_pixel[2] = {back.value[back.kPixel], back.value[back.kPixel + 1]};
    const Float offset[3] = {back.value[back.kOffset], back.value[back.kOffset + 1],
                             back.value[back.kOffset + 2]};
    Float turns(0.f);
    if constexpr (order > 0) turns = turns_of(stored.mean[3], f.exact_camera, s.duration);
    const Viewing view = viewing(offset, turns);
    // ∂ ln σ(o)/∂o = 1 - σ(o); none beyond ±80, where exp is cut off
    const Float d_opacity = zero_unless(Float(kLargestExponent) >= abs(stored.opacity_logit),
                                        slot[kSlotPower] / (Float(1.f) + exp(stored.opacity_logit)));

    if constexpr (motion == Motion::kStatic) {
        add_to_rows3(out.mean, ids, count, d_stored.mean);
        add_to_rows3(out.log_scale, ids, count, d_stored.log_scale);
    } else {
        add_to_rows4(out.mean, ids, count, d_stored.mean);
        add_to_rows4(out.log_scale, ids, count, d_stored.log_scale);
    }
    add_to_rows4(out.quat_left, ids, count, d_stored.quat_left);
    if constexpr (motion == Motion::kFull) add_to_rows4(out.quat_right, ids, count, d_stored.quat_right);
    alignas(64) scalar lane[16];
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
        scalar value[16];
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
