// Passes over whole arrays that training makes once an iteration, each thread over its share of them.
#pragma once

#include <algorithm>
#include <cstring>
#include <limits>

#include "vec.hpp"

namespace splat {

inline constexpr int64_t kSweep = 1 << 16;  // floats a thread takes at a time

inline void set_to_zero(scalar* p, int64_t count, int threads) {
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t first = 0; first < count; first += kSweep)
        std::memset(p + first, 0, sizeof(scalar) * std::min(kSweep, count - first));
}

// Neither NaN nor infinity among them.
inline bool all_finite(const scalar* p, int64_t count, int threads) {
    bool finite = true;
#pragma omp parallel for schedule(static) num_threads(threads) reduction(&& : finite)
    for (int64_t first = 0; first < count; first += kSweep) {
        const int64_t last = std::min(first + kSweep, count);
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
