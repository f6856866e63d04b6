// (1-λ) L1 + λ (1-SSIM) of two images, and its gradient: 11×11 Gaussian window, σ = 1.5, zero padding, C1 =
// 0.01², C2 = 0.03² (Wang et al. 2004, as in 3D Gaussian Splatting).
//
// The window is separable: rows, then columns. With m, n the windowed means of x and y, and s, r those of
// x²+y² and xy,
//     SSIM = A1 A2 / (B1 B2),  A1 = 2mn + C1,  A2 = 2(r - mn) + C2,  B1 = m² + n² + C1,  B2 = s - m² - n² +
//     C2,
// and the window being symmetric, ∂ΣSSIM/∂x = window(∂/∂m) + 2x window(∂/∂s) + y window(∂/∂r).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "buffer.hpp"

namespace splat {

inline constexpr int kWindowReach = 5;

inline std::array<float, kWindowReach + 1> window_weights() {  // [k]: at distance k
    std::array<float, kWindowReach + 1> w{};
    double total = 0;
    for (int k = -kWindowReach; k <= kWindowReach; ++k) total += std::exp(-k * k / 4.5);
    for (int k = 0; k <= kWindowReach; ++k) w[k] = static_cast<float>(std::exp(-k * k / 4.5) / total);
    return w;
}

// out[i] = Σ_k w[|k|] in[i + k·step]; the caller pads.
inline void convolve(const float* __restrict in, float* __restrict out, long count, long step,
                     const float* w) {
    const float w0 = w[0], w1 = w[1], w2 = w[2], w3 = w[3], w4 = w[4], w5 = w[5];
#pragma omp simd
    for (long i = 0; i < count; ++i)
        out[i] = w0 * in[i] + w1 * (in[i - step] + in[i + step]) +
                 w2 * (in[i - 2 * step] + in[i + 2 * step]) + w3 * (in[i - 3 * step] + in[i + 3 * step]) +
                 w4 * (in[i - 4 * step] + in[i + 4 * step]) + w5 * (in[i - 5 * step] + in[i + 5 * step]);
}

struct LossValue {
    double l1, ssim;  // means over pixels and channels
};

class L1Ssim {
public:
    // image, target, gradient: planes [3, height, width]. gradient = ∂ ((1-λ) L1 + λ (1-SSIM)) / ∂ image.
    LossValue operator()(const float* image, const float* target, int width, int height, float ssim_weight,
                         float* gradient, int threads) {
        // Row-filtered maps keep kWindowReach zero rows above and below: the column filter needs no border
        // case.
        const long padded_rows = height + 2 * kWindowReach, map = padded_rows * width;
        filtered_.resize(4 * map);
        partial_.resize(3 * map);
        row_l1_.assign(3 * height, 0.0);
        row_ssim_.assign(3 * height, 0.0);
        const auto w = window_weights();
        const size_t plane = static_cast<size_t>(width) * height;
        const float scale = 1.f / (3.f * plane);
        for (int m = 0; m < 4; ++m) clear_padding(&filtered_[m * map], width, height);
        for (int m = 0; m < 3; ++m) clear_padding(&partial_[m * map], width, height);
        for (int c = 0; c < 3; ++c) {
            const float *x = image + c * plane, *y = target + c * plane;
#pragma omp parallel num_threads(threads)
            {
                std::vector<float> row(4 * (width + 2 * kWindowReach), 0.f), column(4 * width);
#pragma omp for schedule(static)
                for (int r = 0; r < height; ++r) filter_rows(x, y, r, width, map, w.data(), row.data());
                std::fill(row.begin(), row.end(), 0.f);
#pragma omp for schedule(static)
                for (int r = 0; r < height; ++r)
                    row_ssim_[c * height + r] = ssim_row(r, width, map, w.data(), row.data(), column.data());
#pragma omp for schedule(static)
                for (int r = 0; r < height; ++r)
                    row_l1_[c * height + r] = gradient_row(x, y, gradient + c * plane, r, width, map,
                                                           w.data(), column.data(), ssim_weight, scale);
            }
        }
        LossValue value{0, 0};  // summed row by row: the same bits for any number of threads
        for (double v : row_l1_) value.l1 += v;
        for (double v : row_ssim_) value.ssim += v;
        value.l1 /= 3.0 * plane;
        value.ssim /= 3.0 * plane;
        return value;
    }

private:
    static void clear_padding(float* map, int width, int height) {
        const size_t border = static_cast<size_t>(kWindowReach) * width;
        std::fill(map, map + border, 0.f);
        std::fill(map + border + static_cast<size_t>(height) * width,
                  map + 2 * border + static_cast<size_t>(height) * width, 0.f);
    }
    float* map_row(Buffer<float>& maps, int m, long map, int r, int width) {
        return &maps[m * map + static_cast<long>(r + kWindowReach) * width];
    }

    // x, y, x²+y² and xy of row r, filtered along the row.
    void filter_rows(const float* x, const float* y, int r, int width, long map, const float* w, float* row) {
        const int stride = width + 2 * kWindowReach;
        float* at[4];
        for (int m = 0; m < 4; ++m) at[m] = row + m * stride + kWindowReach;
        for (int i = 0; i < width; ++i) {
            const float a = x[static_cast<size_t>(r) * width + i], b = y[static_cast<size_t>(r) * width + i];
            at[0][i] = a, at[1][i] = b, at[2][i] = a * a + b * b, at[3][i] = a * b;
        }
        for (int m = 0; m < 4; ++m) convolve(at[m], map_row(filtered_, m, map, r, width), width, 1, w);
    }

    // Σ SSIM of row r; its partial derivatives, filtered along the row, into partial_.
    double ssim_row(int r, int width, long map, const float* w, float* row, float* column) {
        constexpr float c1 = 1e-4f, c2 = 9e-4f;
        const int stride = width + 2 * kWindowReach;
        for (int m = 0; m < 4; ++m)
            convolve(map_row(filtered_, m, map, r, width), column + m * width, width, width, w);
        const float *mean_x = column, *mean_y = column + width, *squares = column + 2 * width,
                    *product = column + 3 * width;
        float* __restrict by_mean = row + kWindowReach;
        float* __restrict by_squares = row + stride + kWindowReach;
        float* __restrict by_product = row + 2 * stride + kWindowReach;
        float sum = 0;
#pragma omp simd reduction(+ : sum)
        for (int i = 0; i < width; ++i) {
            const float a = mean_x[i], b = mean_y[i], q = a * a + b * b;
            const float a1 = 2 * a * b + c1, a2 = 2 * (product[i] - a * b) + c2, b1 = q + c1,
                        b2 = squares[i] - q + c2;
            const float inverse1 = 1 / b1, inverse2 = 1 / b2, inverse = inverse1 * inverse2,
                        ssim = a1 * a2 * inverse;
            sum += ssim;
            by_mean[i] = 2 * b * (a2 - a1) * inverse - 2 * a * ssim * (inverse1 - inverse2);
            by_squares[i] = -ssim * inverse2;
            by_product[i] = 2 * a1 * inverse;
        }
        for (int m = 0; m < 3; ++m)
            convolve(row + m * stride + kWindowReach, map_row(partial_, m, map, r, width), width, 1, w);
        return sum;
    }

    // Gradient of row r; returns Σ |x - y|.
    double gradient_row(const float* x, const float* y, float* gradient, int r, int width, long map,
                        const float* w, float* column, float ssim_weight, float scale) {
        for (int m = 0; m < 3; ++m)
            convolve(map_row(partial_, m, map, r, width), column + m * width, width, width, w);
        const float *xr = x + static_cast<size_t>(r) * width, *yr = y + static_cast<size_t>(r) * width;
        float* __restrict out = gradient + static_cast<size_t>(r) * width;
        float sum = 0;
#pragma omp simd reduction(+ : sum)
        for (int i = 0; i < width; ++i) {
            const float difference = xr[i] - yr[i];
            sum += std::fabs(difference);
            const float sign = static_cast<float>(difference > 0) - static_cast<float>(difference < 0);
            const float d_ssim = column[i] + 2 * xr[i] * column[width + i] + yr[i] * column[2 * width + i];
            out[i] = scale * ((1 - ssim_weight) * sign - ssim_weight * d_ssim);
        }
        return sum;
    }

    Buffer<float> filtered_, partial_;
    std::vector<double> row_l1_, row_ssim_;
};

}  // namespace splat
