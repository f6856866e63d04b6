// The window of SSIM, 11×11 with σ = 1.5: separable, so columns are filtered, then rows.
#pragma once

#include <array>
#include <cmath>

#include "simd/vec.hpp"

namespace splat {

inline constexpr int kWindowReach = 5, kWindow = 2 * kWindowReach + 1;
// Rows filtered together: 14 rows are then loaded instead of 44.
inline constexpr int kRows = 4;

inline std::array<scalar, kWindow> window_weights() {
    std::array<scalar, kWindow> w{};
    double total = 0;
    for (int k = -kWindowReach; k <= kWindowReach; ++k) total += std::exp(-k * k / 4.5);
    for (int k = -kWindowReach; k <= kWindowReach; ++k)
        w[k + kWindowReach] = static_cast<scalar>(std::exp(-k * k / 4.5) / total);
    return w;
}

// Filters the columns of `maps` maps for kRows rows. at(k, value) gives the maps' values k - kWindowReach
// rows below the first.
template <int maps, class At>
SPLAT_INLINE void filter_columns(const scalar* w, At&& at, Float (&out)[maps][kRows]) {
    for (auto& map : out)
        for (auto& row : map) row = 0.f;
#pragma GCC unroll 14
    for (int k = 0; k < kWindow + kRows - 1; ++k) {
        Float value[maps];
        at(k, value);
#pragma GCC unroll 4
        for (int j = 0; j < kRows; ++j)
            if (k >= j && k - j < kWindow)
#pragma GCC unroll 4
                for (int m = 0; m < maps; ++m) out[m][j] += Float(w[k - j]) * value[m];
    }
}

SPLAT_INLINE Float filter_row(const scalar* w, const scalar* centre) {
    Float sum(0.f);
#pragma GCC unroll 11
    for (int k = 0; k < kWindow; ++k) sum += Float(w[k]) * Float::load(centre + k - kWindowReach);
    return sum;
}

}  // namespace splat
