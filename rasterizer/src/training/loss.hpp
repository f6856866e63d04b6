// The loss (1-λ) L1 + λ (1-SSIM) + μ MSE and its gradient: SSIM (Wang et al. 2004) and λ as in 3D Gaussian
// Splatting, where μ is 0.
//
// SSIM has an 11×11 Gaussian window with σ = 1.5 (ssim_window.hpp), zero padding, C1 = 0.01², C2 = 0.03².
// With m, n the windowed means of x and y, and s, r those of x²+y² and xy,
//     SSIM = A1 A2 / (B1 B2),  A1 = 2mn + C1,  A2 = 2(r - mn) + C2,  B1 = m² + n² + C1,
//     B2 = s - m² - n² + C2,
// and since the window is symmetric, ∂ΣSSIM/∂x = window(∂/∂m) + 2x window(∂/∂s) + y window(∂/∂r).
//
// A thread goes down a band of rows, four at a time, and keeps only the last rows of each intermediate map,
// in the second-level cache. No map of the whole image is written. Blocks of background copy their values
// from the first such block (loss_background.hpp).
#pragma once

#include <omp.h>

#include <algorithm>
#include <exception>
#include <optional>
#include <vector>

#include "simd/vec.hpp"
#include "training/loss_background.hpp"
#include "training/ssim_window.hpp"

namespace splat {

inline constexpr int kMeans = 4, kPartials = 3;

struct LossValue {
    double l1, ssim, mse;  // means over pixels and channels
};

// A band of rows of one channel, and where its results go.
struct LossBand {
    const scalar *image, *target;  // of the channel
    scalar* gradient;
    double *row_l1, *row_ssim, *row_square;  // sums of each row
    int width, height, first, last;
    scalar l1_scale, ssim_scale, mse_scale;  // of the gradient
    bool copy_background;                    // false: every block is computed
};

// Scratch rows of one thread, with zeros on both sides: filtering along a row then needs no border case.
class LossRows {
public:
    explicit LossRows(int width)
        : stride_((width + kLanes - 1) / kLanes * kLanes + 2 * kLanes),
          data_(static_cast<size_t>(stride_) * (kMeans * kRows + kPartials * kRing + 1), 0.f) {}
    scalar* column_filtered(int map, int row) { return at(map * kRows + row); }
    scalar* partial(int map, int row) { return at(kMeans * kRows + map * kRing + (row & (kRing - 1))); }
    const scalar* zeros() { return at(kMeans * kRows + kPartials * kRing); }

private:
    static constexpr int kRing = 32;  // at least 14 rows being read and 4 being written
    scalar* at(int row) { return data_.data() + static_cast<size_t>(stride_) * row + kLanes; }
    int stride_;
    std::vector<scalar> data_;
};

SPLAT_INLINE Float first_lanes(const Float& v, int count) {
    if (count >= kLanes) return v;
    alignas(64) scalar lane[kLanes];
    v.store(lane);
    return Float::load_first(lane, count);
}
SPLAT_INLINE scalar sum_of_lanes(const Float& v) {
    alignas(64) scalar lane[kLanes];
    v.store(lane);
    scalar sum = 0;
    for (scalar x : lane) sum += x;
    return sum;
}

// Rows [row, row + kRows): the three partial derivatives of ΣSSIM, and the sums of SSIM.
inline void ssim_rows(const LossBand& p, const scalar* w, int row, LossRows& rows,
                      LossBackground& background) {
    const scalar *x[kWindow + kRows - 1], *y[kWindow + kRows - 1];
    for (int k = 0; k < kWindow + kRows - 1; ++k) {
        const int r = row + k - kWindowReach;
        const bool inside = r >= 0 && r < p.height;
        x[k] = inside ? p.image + static_cast<size_t>(r) * p.width : rows.zeros();
        y[k] = inside ? p.target + static_cast<size_t>(r) * p.width : rows.zeros();
    }
    background.find(row - kWindowReach, row + kRows + kWindowReach);
    auto filter_lanes = [&](int i, auto&& load) {
        const bool is_background = background.at(i / kLanes);
        if (is_background && background.mean.known) {
            if (background.ssim_and_partial.known && background.far_around(i / kLanes)) return;
            for (int m = 0; m < kMeans; ++m)
                for (int j = 0; j < kRows; ++j) background.mean.of[m].store(rows.column_filtered(m, j) + i);
            return;
        }
        Float mean[kMeans][kRows];
        filter_columns<kMeans>(
            w,
            [&](int k, Float(&value)[kMeans]) {
                value[0] = load(x[k] + i), value[1] = load(y[k] + i);
                value[2] = value[0] * value[0] + value[1] * value[1], value[3] = value[0] * value[1];
            },
            mean);
        for (int m = 0; m < kMeans; ++m)
            for (int j = 0; j < kRows; ++j) mean[m][j].store(rows.column_filtered(m, j) + i);
        if (is_background) background.mean.set({mean[0][0], mean[1][0], mean[2][0], mean[3][0]});
    };
    const int whole = p.width / kLanes * kLanes, rest = p.width - whole;
    for (int i = 0; i < whole; i += kLanes)
        filter_lanes(i, [](const scalar* from) { return Float::load(from); });
    if (rest) filter_lanes(whole, [&](const scalar* from) { return Float::load_first(from, rest); });

    const Float c1(1e-4f), c2(9e-4f), one(1.f), two(2.f);
    for (int j = 0; j < std::min(kRows, p.height - row); ++j) {
        Float total(0.f);
        for (int i = 0; i < p.width; i += kLanes) {
            const int count = p.width - i;
            const bool is_background = background.around(i / kLanes);
            if (is_background && background.ssim_and_partial.known) {
                const auto& of = background.ssim_and_partial.of;
                total += first_lanes(of[0], count);
                for (int m = 0; m < kPartials; ++m)
                    first_lanes(of[1 + m], count).store(rows.partial(m, row + j) + i);
                continue;
            }
            Float mean[kMeans];
            for (int m = 0; m < kMeans; ++m) mean[m] = filter_row(w, rows.column_filtered(m, j) + i);
            const Float &a = mean[0], &b = mean[1], ab = a * b, q = a * a + b * b;
            const Float a1 = two * ab + c1, a2 = two * (mean[3] - ab) + c2, b1 = q + c1,
                        b2 = mean[2] - q + c2;
            const Float inverse = one / (b1 * b2), inverse1 = inverse * b2, inverse2 = inverse * b1;
            const Float ssim = a1 * a2 * inverse;
            total += first_lanes(ssim, count);
            const Float by_mean = two * b * (a2 - a1) * inverse - two * a * ssim * (inverse1 - inverse2);
            first_lanes(by_mean, count).store(rows.partial(0, row + j) + i);
            first_lanes(-ssim * inverse2, count).store(rows.partial(1, row + j) + i);
            first_lanes(two * a1 * inverse, count).store(rows.partial(2, row + j) + i);
            if (is_background)
                background.ssim_and_partial.set({ssim, by_mean, -ssim * inverse2, two * a1 * inverse});
            else
                background.partials_differ(i / kLanes, row + j);
        }
        if (row + j >= p.first && row + j < p.last) p.row_ssim[row + j] = sum_of_lanes(total);
    }
}

// Those of rows [row, row + kRows) that are the band's: the gradient, and the sums of |x - y| and (x - y)².
inline void gradient_rows(const LossBand& p, const scalar* w, int row, LossRows& rows,
                          LossBackground& background) {
    const scalar* partial[kPartials][kWindow + kRows - 1];
    for (int k = 0; k < kWindow + kRows - 1; ++k) {
        const int r = row + k - kWindowReach;
        for (int m = 0; m < kPartials; ++m)
            partial[m][k] = r >= 0 && r < p.height ? rows.partial(m, r) : rows.zeros();
    }
    background.find_in_partials(row - kWindowReach, row + kRows + kWindowReach);
    for (int i = 0; i < p.width; i += kLanes) {
        const int count = p.width - i;
        const bool is_background = background.at(i / kLanes);
        if (is_background && background.filtered_partial.known) {
            if (background.gradient.known && background.far_around(i / kLanes)) continue;
            for (int m = 0; m < kPartials; ++m) {
                const Float value = first_lanes(background.filtered_partial.of[m], count);
                for (int j = 0; j < kRows; ++j) value.store(rows.column_filtered(m, j) + i);
            }
            continue;
        }
        Float filtered[kPartials][kRows];
        filter_columns<kPartials>(
            w,
            [&](int k, Float(&value)[kPartials]) {
                for (int m = 0; m < kPartials; ++m) value[m] = Float::load(partial[m][k] + i);
            },
            filtered);
        for (int m = 0; m < kPartials; ++m)
            for (int j = 0; j < kRows; ++j) filtered[m][j].store(rows.column_filtered(m, j) + i);
        if (is_background && count >= kLanes)
            background.filtered_partial.set({filtered[0][0], filtered[1][0], filtered[2][0]});
    }
    const Float l1_scale(p.l1_scale), ssim_scale(-p.ssim_scale), mse_scale(p.mse_scale), two(2.f), zero(0.f);
    for (int j = 0; j < std::min(kRows, p.last - row); ++j) {
        const size_t at = static_cast<size_t>(row + j) * p.width;
        Float total(0.f), squares(0.f);
        for (int i = 0; i < p.width; i += kLanes) {
            const int count = std::min(kLanes, p.width - i);
            const bool is_background = background.around(i / kLanes);
            if (is_background && background.gradient.known) {
                background.gradient.of[0].store_first(p.gradient + at + i, count);
                continue;  // |x - y| is zero
            }
            const Float x = Float::load_first(p.image + at + i, count),
                        y = Float::load_first(p.target + at + i, count);
            const Float d_ssim = filter_row(w, rows.column_filtered(0, j) + i) +
                                 two * x * filter_row(w, rows.column_filtered(1, j) + i) +
                                 y * filter_row(w, rows.column_filtered(2, j) + i);
            const Float difference = x - y;
            total += abs(difference);
            squares += difference * difference;
            const Float sign =
                zero_unless(difference > zero, l1_scale) - zero_unless(difference < zero, l1_scale);
            const Float gradient = sign + ssim_scale * d_ssim + two * mse_scale * difference;
            gradient.store_first(p.gradient + at + i, count);
            if (is_background) background.gradient.set({gradient});
        }
        p.row_l1[row + j] = sum_of_lanes(total);
        p.row_square[row + j] = sum_of_lanes(squares);
    }
}

// One band. The partial derivatives five rows around it are computed too, so that bands are independent.
inline void loss_band(const LossBand& p, const scalar* w, LossRows& rows) {
    const int end = std::min(p.height, p.last + kWindowReach);
    const int first = std::max(0, p.first - kWindowReach);
    LossBackground background(p.image, p.target, p.width, p.height, first - kWindowReach, p.copy_background);
    int next = p.first;
    for (int row = first; row < end; row += kRows) {
        ssim_rows(p, w, row, rows, background);
        const int done = std::min(p.height, row + kRows);
        for (; next < p.last &&
               std::min({next + kRows + kWindowReach, p.last + kWindowReach, p.height}) <= done;
             next += kRows)
            gradient_rows(p, w, next, rows, background);
    }
}

// image, target: planes [3, height, width]. gradient = share · ∂ loss / ∂ image, with λ = ssim_weight and
// μ = mse_weight.
inline LossValue photometric_loss(const scalar* image, const scalar* target, int width, int height,
                                  scalar ssim_weight, scalar mse_weight, scalar share, scalar* gradient,
                                  bool copy_background, int threads) {
    const auto w = window_weights();
    const size_t plane = static_cast<size_t>(width) * height;
    const scalar scale = share / (3.f * plane);
    std::vector<double> row_l1(3 * height), row_ssim(3 * height), row_square(3 * height);
    const int bands = std::clamp(height / 32, 1, threads);  // a band of a channel
    const auto first_row = [&](int band) { return static_cast<int>(int64_t{height} * band / bands); };
    std::vector<std::optional<LossRows>> thread_rows(threads);
    std::exception_ptr failed;  // for lack of memory: no exception may leave the region
#pragma omp parallel for schedule(dynamic, 1) num_threads(threads)
    for (int task = 0; task < 3 * bands; ++task) {
        try {
            std::optional<LossRows>& rows = thread_rows[omp_get_thread_num()];
            if (!rows) rows.emplace(width);
            const int c = task / bands, band = task % bands;
            const LossBand p{image + c * plane,
                             target + c * plane,
                             gradient + c * plane,
                             &row_l1[c * height],
                             &row_ssim[c * height],
                             &row_square[c * height],
                             width,
                             height,
                             first_row(band),
                             first_row(band + 1),
                             (1 - ssim_weight) * scale,
                             ssim_weight * scale,
                             mse_weight * scale,
                             copy_background};
            loss_band(p, w.data(), *rows);
        } catch (...) {
#pragma omp critical
            failed = std::current_exception();
        }
    }
    if (failed) std::rethrow_exception(failed);
    LossValue value{0, 0, 0};  // summed row by row: the same bits for any number of threads
    for (double v : row_l1) value.l1 += v;
    for (double v : row_ssim) value.ssim += v;
    for (double v : row_square) value.mse += v;
    value.l1 /= 3.0 * plane;
    value.ssim /= 3.0 * plane;
    value.mse /= 3.0 * plane;
    return value;
}

}  // namespace splat
