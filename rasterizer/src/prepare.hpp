// Stage 1: which Gaussians are seen at time t, where, how large, how bright and in which colour.
//
// Chunks of Gaussians, each by one thread: cull in time, slice, project, cull on the screen, colour, stage.
#pragma once

#include <algorithm>

#include "color.hpp"
#include "far.hpp"
#include "frame.hpp"
#include "look.hpp"

namespace splat {

// Σtt's time row is R's times the scales, R good to 1e-7: Σtt at most so much larger, in parts of itself and
// of the largest scale's square. What is let in wrongly is left out after its slice.
inline constexpr scalar kVarianceSlack = 1e-4f, kScaleSlack = 1e-8f;

// Ids of the chunk's Gaussians that may have p(t) >= 0.05, packed; returns how many. Only M's time row is
// computed.
template <Motion motion>
inline int cull_in_time(const Parameters& p, uint32_t first, uint32_t last, const Camera& c,
                        uint32_t* alive) {
    int n = 0;
    if constexpr (motion == Motion::kStatic) {
        for (uint32_t id = first; id < last; ++id) alive[n++] = id;
        return n;
    }
    for (uint32_t base = first; base < last; base += kLanes) {
        uint32_t ids[kLanes];
        for (uint32_t l = 0; l < kLanes; ++l) ids[l] = std::min(base + l, last - 1);
        Float mean[4], log_scale[4], var_t(0.f), slack(0.f);
        load_rows4(p.mean, ids, mean);
        load_rows4(p.log_scale, ids, log_scale);
        if constexpr (motion == Motion::kFull) {
            Float ql[4], qr[4];
            load_rows4(p.quat_left, ids, ql);
            load_rows4(p.quat_right, ids, qr);
            UnitQuaternion left = normalise(ql), right = normalise(qr);
#pragma GCC unroll 4
            for (int j = 0; j < 4; ++j) {
                Float r(0.f);
#pragma GCC unroll 4
                for (int k = 0; k < 4; ++k) r += left_matrix(left, 3, k) * right_matrix(right, k, j);
                const Float scale = exp(log_scale[j]), m = r * scale;
                var_t += m * m;
                slack += scale * scale;
            }
        } else {
            Float s = exp(log_scale[3]);
            var_t = s * s;
        }
        var_t += var_t * Float(kVarianceSlack) + slack * Float(kScaleSlack);
        const Float dt = (Float(c.time) - mean[3]) + Float(c.time_low);
        unsigned in_time = bits(dt * dt <= max(var_t, kMinTimeVariance) * Float(kMinusTwoLogMinPresence));
        if (last - base < kLanes) in_time &= (1u << (last - base)) - 1;
        n += pack_kept(ids, in_time, alive + n);
    }
    return n;
}

// The visible Gaussians of a chunk, one array a quantity.
struct Packed {
    static constexpr int kFields = 16 + kMaxExtra;
    enum Field {
        kX,
        kY,
        kIntercept,
        kLean,
        kAcross,
        kAlong,
        kLogOpacity,
        kDepth,
        kDepthLow,  // of far Gaussians alone
        kHalfWidth,
        kHalfHeight,
        kRadius,
        kTurns,
        kOffset,
        kExtraField = kOffset + 3
    };
    alignas(64) scalar value[kFields][kChunk + kLanes];
    uint32_t id[kChunk + kLanes];
    int count = 0;
    bool far = false;  // some are

    Float at(int field, int i) const { return Float::load(&value[field][i]); }
};

// (t - μt)/T less the nearest integer, in double: after a million turns float32 has no digit of the last one
// left.
SPLAT_INLINE Float turns_of(const Float& mean_t, const CameraOf<double>& c, double duration) {
    alignas(64) scalar lane[kLanes];
    mean_t.store(lane);
    const double rate = 1.0 / duration;
    for (scalar& x : lane) {
        const double turns = (c.time - static_cast<double>(x)) * rate;
        x = static_cast<scalar>(turns - __builtin_nearbyint(turns));
    }
    return Float::load(lane);
}

// Returns how many have p(t) >= 0.05.
template <Motion motion>
inline int project_chunk(const Parameters& p, const Camera& c, const CameraOf<double>& exact,
                         const Settings& s, uint32_t* alive, int alive_count, Packed& out) {
    using See = Seen<Float>;
    out.count = 0;
    out.far = false;
    const Float beyond(far_depth(s));
    int in_time = 0;
    for (int l = 0; l < kLanes && alive_count > 0; ++l) alive[alive_count + l] = alive[alive_count - 1];
    for (int i = 0; i < alive_count; i += kLanes) {
        const unsigned wanted = alive_count - i < kLanes ? (1u << (alive_count - i)) - 1 : 0xffff;
        const Stored<motion, Float> stored = Stored<motion, Float>::load(p, alive + i);
        const See see = look(stored, wanted, c, exact, s);
        const Float(&v)[See::kFields] = see.value;
        // log2 of the peak alpha = sigmoid(logit) p(t)
        Float log2_opacity = v[See::kLog2Marginal] - log2(Float(1.f) + exp(-stored.opacity_logit));
        Float reach2 = max((log2_opacity - Float(kLog2MinAlpha)) * Float(2.f / kLog2E),
                           0.f);  // squared Mahalanobis radius of 1/255
        Float half_width = sqrt(reach2 * v[See::kVarianceX]), half_height = sqrt(reach2 * v[See::kVarianceY]);
        const unsigned present = bits(v[See::kLog2Marginal] >= Float(kLog2MinPresence)) & wanted;
        in_time += __builtin_popcount(present);
        Mask seen =
            (v[See::kDepth] > Float(s.near_plane)) & (reach2 > Float(0.f)) &
            (v[See::kX] + half_width >= Float(0.f)) & (v[See::kX] - half_width <= Float(c.width - 1.f)) &
            (v[See::kY] + half_height >= Float(0.f)) & (v[See::kY] - half_height <= Float(c.height - 1.f));
        const unsigned keep = bits(seen) & present;
        if (!keep) continue;
        const Float mid = Float(0.5f) * (v[See::kVarianceX] + v[See::kVarianceY]);
        const Float gap = Float(0.5f) * (v[See::kVarianceX] - v[See::kVarianceY]) / mid,
                    tilt = v[See::kCovariance] / mid;  // divided first: a variance's square may overflow
        const Float largest_variance = mid + mid * sqrt(gap * gap + tilt * tilt);
        auto put = [&](int field, const Float& x) { store_packed(&out.value[field][out.count], keep, x); };
        put(Packed::kX, v[See::kX]);
        put(Packed::kY, v[See::kY]);
        put(Packed::kIntercept, v[See::kIntercept]);
        put(Packed::kLean, v[See::kLean]);
        put(Packed::kAcross, v[See::kInverseAcross] * Float(-0.5f * kLog2E));
        put(Packed::kAlong, v[See::kInverseAlong] * Float(-0.5f * kLog2E));
        put(Packed::kLogOpacity, log2_opacity);
        put(Packed::kDepth, v[See::kDepth]);
        if (const unsigned far = bits(v[See::kDepth] > beyond) & keep) [[unlikely]] {
            const Depths z = far_depths(stored, far, exact, v[See::kDepth]);
            put(Packed::kDepth, z.high);
            put(Packed::kDepthLow, z.low);
            out.far = true;
        }
        put(Packed::kHalfWidth, half_width);
        put(Packed::kHalfHeight, half_height);
        put(Packed::kRadius, Float(3.f) * sqrt(largest_variance));
        if constexpr (motion != Motion::kStatic)
            if (s.fourier_order > 0) put(Packed::kTurns, turns_of(stored.mean[3], exact, s.duration));
        for (int k = 0; k < 3; ++k) put(Packed::kOffset + k, v[See::kOffset + k]);
        int extra = Packed::kExtraField;
        if (s.depth) put(extra++, v[See::kDepth]);
        if (s.flow) {
            put(extra++, v[See::kFlow]);
            put(extra++, v[See::kFlow + 1]);
        }
        if constexpr (motion != Motion::kStatic) {  // a static model has no time to tell of
            if (s.stats) {
                put(extra++, stored.mean[3]);
                put(extra++, v[See::kVarianceT]);
            }
        }
        out.count += pack_kept(alive + i, keep, out.id + out.count);
    }
    return in_time;
}

template <int order, bool differentiable>
inline void color_and_stage(const Parameters& p, const Settings& s, Packed& in, Splat* staged,
                            ColorSlope* slopes, scalar* extras) {
    const int extra_channels = s.extra_channels();
    const int used = std::min(p.coefficients, (s.sh_degree + 1) * (s.sh_degree + 1));
    auto fetch = [&](int i) {
        return RowFetch(p, in.id + i, std::clamp(in.count - i, 0, kLanes), order, used);
    };
    fetch(0).rest();
    for (int i = 0; i < in.count; i += kLanes) {
        const int n = std::min(kLanes, in.count - i);
        Float offset[3] = {in.at(Packed::kOffset, i), in.at(Packed::kOffset + 1, i),
                           in.at(Packed::kOffset + 2, i)};
        Float turns(0.f);
        if constexpr (order > 0) turns = in.at(Packed::kTurns, i);
        Color c;
        color<order, differentiable>(p, in.id + i, n, fetch(i + kLanes), viewing(offset, turns),
                                     static_cast<scalar>(s.duration), s.sh_degree, c);
        Float row[16] = {in.at(Packed::kX, i),
                         in.at(Packed::kY, i),
                         in.at(Packed::kIntercept, i),
                         in.at(Packed::kLean, i),
                         in.at(Packed::kAcross, i),
                         in.at(Packed::kAlong, i),
                         in.at(Packed::kLogOpacity, i),
                         max(c.rgb[0], 0.f),
                         max(c.rgb[1], 0.f),
                         max(c.rgb[2], 0.f),
                         in.at(Packed::kDepth, i),
                         in.at(Packed::kHalfWidth, i),
                         in.at(Packed::kHalfHeight, i),
                         in.at(Packed::kRadius, i),
                         Float::load_bits(in.id + i),
                         0.f};
        transpose(row);
        for (int l = 0; l < n; ++l) {
            row[l].store(&staged[i + l].x);
            for (int e = 0; e < extra_channels; ++e)
                extras[kExtraStride * (i + l) + e] = in.value[Packed::kExtraField + e][i + l];
        }
        if constexpr (differentiable) {
            Float slope[16];
            for (int k = 0; k < 9; ++k) slope[k] = c.by_offset[k / 3][k % 3];
            for (int k = 0; k < 3; ++k) slope[9 + k] = c.by_dt[k];
            for (int k = 0; k < 3; ++k) slope[12 + k] = select(c.rgb[k] < Float(0.f), 0.f, 1.f);
            slope[15] = 0.f;
            transpose(slope);
            for (int l = 0; l < n; ++l)
                slope[l].stream(&slopes[i + l].by_offset[0][0]);  // not read before the backward pass
        }
    }
}

template <Motion motion, int order, bool differentiable>
inline void prepare(Frame& f, const Parameters& p) {
    StageTimer timer(f, kStagePrepare);
    const int chunks = static_cast<int>((p.count + kChunk - 1) / kChunk);
    f.staged.resize(static_cast<size_t>(chunks) * kChunk);
    f.depth.resize(static_cast<size_t>(chunks) * kChunk);
    f.depth_low.resize(static_cast<size_t>(chunks) * kChunk);
    if (differentiable) f.color_slope.resize(static_cast<size_t>(chunks) * kChunk);
    if (f.settings.extra_channels()) f.extras.resize(static_cast<size_t>(chunks) * kChunk * kExtraStride);
    f.chunk_count.assign(chunks, 0);
    f.chunk_alive.assign(chunks, 0);
    f.chunk_first.assign(chunks + 1, 0);
#pragma omp parallel num_threads(f.settings.threads)
    {
        Packed packed;
        uint32_t alive[kChunk + kLanes];
#pragma omp for schedule(dynamic, 1)
        for (int c = 0; c < chunks; ++c) {
            const uint32_t first = static_cast<uint32_t>(c) * kChunk,
                           last = std::min(p.count, first + kChunk);
            const int n = cull_in_time<motion>(p, first, last, f.camera, alive);
            f.chunk_alive[c] =
                project_chunk<motion>(p, f.camera, f.exact_camera, f.settings, alive, n, packed);
            color_and_stage<order, differentiable>(
                p, f.settings, packed, f.staged.data() + first,
                differentiable ? f.color_slope.data() + first : nullptr,
                f.extras.data() + static_cast<size_t>(first) * kExtraStride);
            std::copy_n(packed.value[Packed::kDepth], packed.count, &f.depth[first]);
            if (packed.far) std::copy_n(packed.value[Packed::kDepthLow], packed.count, &f.depth_low[first]);
            f.chunk_count[c] = packed.count;
        }
        end_of_streaming();
    }
    f.alive = 0;
    for (int c = 0; c < chunks; ++c) {
        f.chunk_first[c + 1] = f.chunk_first[c] + f.chunk_count[c];
        f.alive += f.chunk_alive[c];
    }
    f.visible = f.chunk_first[chunks];
}

}  // namespace splat
