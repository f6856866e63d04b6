// Passes over whole arrays that training makes each iteration: set to zero, check for NaN and infinity.
#pragma once

#include <algorithm>
#include <cstring>
#include <limits>

#include "simd/vec.hpp"

namespace splat {

inline constexpr int64_t kFloatsPerTask = 1 << 16;

inline void set_to_zero(scalar* p, int64_t count, int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += kFloatsPerTask)
        std::memset(p + first, 0, sizeof(scalar) * std::min(kFloatsPerTask, count - first));
}

// Whether none of them is NaN or infinite.
inline bool all_finite(const scalar* p, int64_t count, int threads) {
    bool finite = true;
#pragma omp parallel for schedule(static) num_threads(threads) reduction(&& : finite)
    for (int64_t first = 0; first < count; first += kFloatsPerTask) {
        const int64_t last = std::min(first + kFloatsPerTask, count);
        Float largest(0.f);
        for (int64_t i = first; i < last; i += kLanes) {
            const Float v = Float::load_first(p + i, static_cast<int>(std::min<int64_t>(kLanes, last - i)));
            largest = max(largest, select(abs(v) <= Float(std::numeric_limits<scalar>::max()), 0.f, 1.f));
        }
        finite = finite && bits(largest > Float(0.f)) == 0;
    }
    return finite;
}

}  // namespace splat
