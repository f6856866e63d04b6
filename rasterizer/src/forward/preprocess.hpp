// Stage 1, preprocess: from the Gaussians' parameters to splats on the screen at time t.
//
// A thread takes a chunk of Gaussians through all steps: cull by the temporal marginal, slice in time,
// project, cull against the image, evaluate colour, write splats. Sixteen Gaussians at a time, one in each
// lane.
#pragma once

#include <algorithm>

#include "forward/depth_in_double.hpp"
#include "forward/project.hpp"
#include "forward/sh.hpp"
#include "view_state.hpp"

namespace splat {

// Margin of the first cull, for the rounding of Σtt: relative to Σtt, and to the sum of squared scales (R has
// an error of 1e-7). A Gaussian that the margin lets in wrongly is culled after it is sliced.
inline constexpr scalar kVarianceSlack = 1e-4f, kScaleSlack = 1e-8f;

// Writes the ids of the chunk's Gaussians that may have p(t) >= 0.05 to `candidates`; returns how many. Needs
// only the time row of M.
template <Motion motion>
inline int cull_in_time(const Parameters& p, uint32_t first, uint32_t last, const Camera& c,
                        uint32_t* candidates) {
    int n = 0;
    if constexpr (motion == Motion::kStatic) {
        for (uint32_t id = first; id < last; ++id) candidates[n++] = id;
        return n;
    }
    for (uint32_t base = first; base < last; base += kLanes) {
        uint32_t ids[kLanes];
        for (uint32_t l = 0; l < kLanes; ++l) ids[l] = std::min(base + l, last - 1);
        Float mean[4], log_scale[4], var_t(0.f), sum_scale2(0.f);
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
                sum_scale2 += scale * scale;
            }
        } else {
            Float s = exp(log_scale[3]);
            var_t = s * s;
        }
        var_t += var_t * Float(kVarianceSlack) + sum_scale2 * Float(kScaleSlack);
        const Float dt = ((Float(c.time) - mean[3]) + Float(c.time_low)) + Float(c.marginal_offset);
        unsigned alive = bits(dt * dt <= max(var_t, kMinTimeVariance) * Float(kMinusTwoLnMinMarginal));
        if (last - base < kLanes) alive &= (1u << (last - base)) - 1;
        n += compress_store_words(ids, alive, candidates + n);
    }
    return n;
}

// The visible Gaussians of a chunk, as a structure of arrays.
struct ProjectedChunk {
    static constexpr int kFields = 16 + kMaxExtraChannels;
    enum Field {
        kX,
        kY,
        kShearedX,
        kShear,
        kConicU,
        kConicV,
        kLogOpacity,
        kDepth,
        kDepthLow,  // only where depth is in double
        kHalfWidth,
        kHalfHeight,
        kRadius,
        kPhase,
        kOffset,
        kExtraField = kOffset + 3
    };
    alignas(64) scalar value[kFields][kChunk + kLanes];
    uint32_t id[kChunk + kLanes];
    int count = 0;
    bool any_double_depth = false;  // kDepthLow holds something

    Float at(int field, int i) const { return Float::load(&value[field][i]); }
};

// Phase of the Fourier basis in turns: (t - μt)/T minus the nearest integer. In double, since float32 has no
// digit of the fraction left after a million periods.
SPLAT_INLINE Float fourier_phase(const Float& mean_t, const CameraOf<double>& c, double duration) {
    alignas(64) scalar lane[kLanes];
    mean_t.store(lane);
    const double rate = 1.0 / duration;
    for (scalar& x : lane) {
        const double phase = (c.time - static_cast<double>(x)) * rate;
        x = static_cast<scalar>(phase - __builtin_nearbyint(phase));
    }
    return Float::load(lane);
}

// Slices, projects and culls the candidates; writes the visible ones to `out`. Returns how many have
// p(t) >= 0.05.
template <Motion motion>
inline int project_chunk(const Parameters& p, const Camera& c, const CameraOf<double>& camera_double,
                         const Settings& s, uint32_t* candidates, int candidate_count, ProjectedChunk& out) {
    using Projected = ProjectedGaussian<Float>;
    out.count = 0;
    out.any_double_depth = false;
    const Float double_depth_threshold(double_depth_from(s));
    int alive_count = 0;
    for (int l = 0; l < kLanes && candidate_count > 0; ++l)
        candidates[candidate_count + l] = candidates[candidate_count - 1];
    for (int i = 0; i < candidate_count; i += kLanes) {
        const unsigned lanes = candidate_count - i < kLanes ? (1u << (candidate_count - i)) - 1 : 0xffff;
        const Stored<motion, Float> stored = Stored<motion, Float>::load(p, candidates + i);
        const Projected projected = project(stored, lanes, c, camera_double, s);
        const Float(&v)[Projected::kFields] = projected.value;
        // log2 of alpha at the mean, sigmoid(logit) p(t)
        Float log2_opacity = v[projected.kLog2Marginal] - log2(Float(1.f) + exp(-stored.opacity_logit));
        // squared Mahalanobis distance at which alpha is 1/255
        Float mahalanobis2 = max((log2_opacity - Float(kLog2MinAlpha)) * Float(2.f / kLog2E), 0.f);
        Float half_width = sqrt(mahalanobis2 * v[projected.kVarianceX]),
              half_height = sqrt(mahalanobis2 * v[projected.kVarianceY]);
        const unsigned alive = bits(v[projected.kLog2Marginal] >= Float(kLog2MinMarginal)) & lanes;
        alive_count += __builtin_popcount(alive);
        Mask on_screen = (v[projected.kDepth] > Float(s.near_plane)) & (mahalanobis2 > Float(0.f)) &
                         (v[projected.kX] + half_width >= Float(0.f)) &
                         (v[projected.kX] - half_width <= Float(c.width - 1.f)) &
                         (v[projected.kY] + half_height >= Float(0.f)) &
                         (v[projected.kY] - half_height <= Float(c.height - 1.f));
        const unsigned keep = bits(on_screen) & alive;
        if (!keep) continue;
        const Float half_trace = Float(0.5f) * (v[projected.kVarianceX] + v[projected.kVarianceY]);
        const Float difference =
                        Float(0.5f) * (v[projected.kVarianceX] - v[projected.kVarianceY]) / half_trace,
                    covariance =
                        v[projected.kCovariance] / half_trace;  // relative: a squared variance may overflow
        const Float largest_eigenvalue =
            half_trace + half_trace * sqrt(difference * difference + covariance * covariance);
        auto compact = [&](int field, const Float& x) {
            compress_store(&out.value[field][out.count], keep, x);
        };
        compact(out.kX, v[projected.kX]);
        compact(out.kY, v[projected.kY]);
        compact(out.kShearedX, v[projected.kShearedX]);
        compact(out.kShear, v[projected.kShear]);
        compact(out.kConicU, v[projected.kInverseVarU] * Float(-0.5f * kLog2E));
        compact(out.kConicV, v[projected.kInverseVarV] * Float(-0.5f * kLog2E));
        compact(out.kLogOpacity, log2_opacity);
        compact(out.kDepth, v[projected.kDepth]);
        if (const unsigned far_lanes = bits(v[projected.kDepth] > double_depth_threshold) & keep)
            [[unlikely]] {
            const SplitDepth z = depths_in_double(stored, far_lanes, camera_double, v[projected.kDepth]);
            compact(out.kDepth, z.high);
            compact(out.kDepthLow, z.low);
            out.any_double_depth = true;
        }
        compact(out.kHalfWidth, half_width);
        compact(out.kHalfHeight, half_height);
        compact(out.kRadius, Float(3.f) * sqrt(largest_eigenvalue));
        if constexpr (motion != Motion::kStatic)
            if (s.fourier_order > 0)
                compact(out.kPhase, fourier_phase(stored.mean[3], camera_double, s.duration));
        for (int k = 0; k < 3; ++k) compact(out.kOffset + k, v[projected.kOffset + k]);
        int extra = out.kExtraField;
        if (s.depth) compact(extra++, v[projected.kDepth]);
        if (s.flow) {
            compact(extra++, v[projected.kFlow]);
            compact(extra++, v[projected.kFlow + 1]);
        }
        if constexpr (motion != Motion::kStatic) {  // a static model has no statistics of time
            if (s.stats) {
                compact(extra++, stored.mean[3]);
                compact(extra++, v[projected.kVarianceT]);
            }
        }
        out.count += compress_store_words(candidates + i, keep, out.id + out.count);
    }
    return alive_count;
}

// Evaluates the colours of the projected Gaussians and writes splats, extra channels and colour Jacobians.
template <int order, bool differentiable>
inline void color_and_write_splats(const Parameters& p, const Settings& s, ProjectedChunk& in, Splat* splats,
                                   ColorJacobian* jacobians, scalar* extras) {
    const int extra_channels = s.extra_channels();
    const int used = std::min(p.coefficients, (s.sh_degree + 1) * (s.sh_degree + 1));
    auto fetch = [&](int i) {
        return RowFetch(p, in.id + i, std::clamp(in.count - i, 0, kLanes), order, used);
    };
    fetch(0).rest();
    for (int i = 0; i < in.count; i += kLanes) {
        const int n = std::min(kLanes, in.count - i);
        Float offset[3] = {in.at(in.kOffset, i), in.at(in.kOffset + 1, i), in.at(in.kOffset + 2, i)};
        Float phase(0.f);
        if constexpr (order > 0) phase = in.at(in.kPhase, i);
        for (int l = 0; l < n; ++l) __builtin_prefetch(&splats[i + l], 1);
        Color c;
        color_from_sh<order, differentiable>(p, in.id + i, n, fetch(i + kLanes),
                                             view_direction(offset, phase), static_cast<scalar>(s.duration),
                                             s.sh_degree, c);
        Float row[16] = {in.at(in.kX, i),
                         in.at(in.kY, i),
                         in.at(in.kShearedX, i),
                         in.at(in.kShear, i),
                         in.at(in.kConicU, i),
                         in.at(in.kConicV, i),
                         in.at(in.kLogOpacity, i),
                         max(c.rgb[0], 0.f),
                         max(c.rgb[1], 0.f),
                         max(c.rgb[2], 0.f),
                         in.at(in.kDepth, i),
                         in.at(in.kHalfWidth, i),
                         in.at(in.kHalfHeight, i),
                         in.at(in.kRadius, i),
                         Float::load_bits(in.id + i),
                         0.f};
        transpose(row);
        for (int l = 0; l < n; ++l) {
            row[l].store(&splats[i + l].x);
            for (int e = 0; e < extra_channels; ++e)
                extras[kExtraStride * (i + l) + e] = in.value[in.kExtraField + e][i + l];
        }
        if constexpr (differentiable) {
            Float jacobian[16];
            for (int k = 0; k < 9; ++k) jacobian[k] = c.wrt_offset[k / 3][k % 3];
            for (int k = 0; k < 3; ++k) jacobian[9 + k] = c.wrt_dt[k];
            for (int k = 0; k < 3; ++k) jacobian[12 + k] = select(c.rgb[k] < Float(0.f), 0.f, 1.f);
            jacobian[15] = 0.f;
            transpose(jacobian);
            for (int l = 0; l < n; ++l)
                jacobian[l].stream(&jacobians[i + l].wrt_offset[0][0]);  // not read before the backward pass
        }
    }
}

inline int chunks_of(uint32_t count) { return static_cast<int>((count + kChunk - 1) / kChunk); }

// Makes room for the splats of `count` Gaussians.
inline void make_room(ViewState& view, uint32_t count) {
    const int chunks = chunks_of(count);
    const size_t splats = static_cast<size_t>(chunks) * kChunk;
    view.splats.resize(splats);
    view.depth.resize(splats);
    view.depth_low.resize(splats);
    if (view.settings.differentiable) view.color_jacobian.resize(splats);
    if (view.settings.extra_channels()) view.extras.resize(splats * kExtraStride);
    view.chunk_count.assign(chunks, 0);
    view.chunk_alive.assign(chunks, 0);
    view.chunk_first.assign(chunks + 1, 0);
}

// A thread's memory for one chunk.
struct ChunkScratch {
    uint32_t candidates[kChunk + kLanes];
    ProjectedChunk projected;
};

template <Motion motion, int order, bool differentiable>
inline void preprocess_chunk(ViewState& view, const Parameters& p, int chunk, ChunkScratch& scratch) {
    const uint32_t first = static_cast<uint32_t>(chunk) * kChunk, last = std::min(p.count, first + kChunk);
    ProjectedChunk& projected = scratch.projected;
    const int n = cull_in_time<motion>(p, first, last, view.camera, scratch.candidates);
    view.chunk_alive[chunk] = project_chunk<motion>(p, view.camera, view.camera_double, view.settings,
                                                    scratch.candidates, n, projected);
    color_and_write_splats<order, differentiable>(
        p, view.settings, projected, view.splats.data() + first,
        differentiable ? view.color_jacobian.data() + first : nullptr,
        view.settings.extra_channels() ? view.extras.data() + static_cast<size_t>(first) * kExtraStride
                                       : nullptr);
    std::copy_n(projected.value[projected.kDepth], projected.count, &view.depth[first]);
    if (projected.any_double_depth)
        std::copy_n(projected.value[projected.kDepthLow], projected.count, &view.depth_low[first]);
    view.chunk_count[chunk] = projected.count;
}

// Sums over the chunks.
inline void count_visible(ViewState& view) {
    const size_t chunks = view.chunk_count.size();
    view.alive = 0;
    for (size_t c = 0; c < chunks; ++c) {
        view.chunk_first[c + 1] = view.chunk_first[c] + view.chunk_count[c];
        view.alive += view.chunk_alive[c];
    }
    view.visible = view.chunk_first[chunks];
}

}  // namespace splat
