// Running statistics of view-space gradients, by which densification decides (docs/method.md 2).
#pragma once

#include <cmath>
#include <cstdint>

#include "numerical_choices.hpp"

namespace splat {

// Per Gaussian, over the views since the arrays were cleared.
struct DensificationStatistics {
    scalar* space;  // Σ |∂L/∂mean2d|, normalised device coordinates
    scalar* time;   // Σ |∂L/∂μt|, per duration
    scalar* views;  // how many show it
};

// Adds one view of `count` Gaussians, each at most once, with mean2d [count, 2] in pixels.
inline void accumulate(const int32_t* visible, const scalar* mean2d, const scalar* mean_t, int64_t count,
                       scalar half_width, scalar half_height, scalar duration,
                       const DensificationStatistics& to, int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < count; ++i) {
        const int32_t g = visible[i];
        const scalar x = mean2d[2 * i] * half_width, y = mean2d[2 * i + 1] * half_height;
        to.space[g] += std::sqrt(x * x + y * y);
        to.time[g] += std::abs(mean_t[i]) * duration;
        to.views[g] += 1.f;
    }
}

// Sets mask[g] = 1 for each of the `count` visible Gaussians g.
inline void mark_visible(const int32_t* visible, int64_t count, uint8_t* mask, int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < count; ++i) mask[visible[i]] = 1;
}

}  // namespace splat
