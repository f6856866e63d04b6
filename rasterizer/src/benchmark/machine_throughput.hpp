// Measures the machine for the benchmark's bound: multiply-adds per second of one thread, and copied bytes.
#pragma once

#include <chrono>
#include <cstring>

#include "buffer.hpp"
#include "simd/vec.hpp"

namespace splat {

struct MachineThroughput {
    double fma_per_second;         // of single lanes: a Float counts sixteen
    double copy_bytes_per_second;  // read and written bytes both count
};

template <class Run>
inline double fastest_seconds(Run&& run) {
    using Clock = std::chrono::steady_clock;
    double best = 1e9;
    for (int repeat = 0; repeat < 5; ++repeat) {
        const auto start = Clock::now();
        run();
        best = std::min(best, std::chrono::duration<double>(Clock::now() - start).count());
    }
    return best;
}

inline MachineThroughput measure_throughput() {
    constexpr int kRounds = 1'000'000;
    constexpr int kChains =
        12 / kParts > 2 ? 12 / kParts : 2;  // independent, to hide the latency in native registers
    Float chain[kChains];
    for (auto& v : chain) v = 0.f;
    const double fma = fastest_seconds([&] {
        const Float a(0.5f), b(1.f);
        for (int i = 0; i < kRounds; ++i)
#pragma GCC unroll 12
            for (auto& v : chain) v = v * a + b;
    });
    scalar result[kLanes];
    for (const auto& v : chain) v.store(result);
    volatile scalar sink = result[0];  // so that the loop is not optimised away
    (void)sink;
    constexpr size_t kBytes = size_t{64} << 20;
    Buffer<char> from, to;
    from.resize(kBytes), to.resize(kBytes);
    std::memset(from.data(), 1, kBytes), std::memset(to.data(), 1, kBytes);
    const double copy = fastest_seconds([&] { std::memcpy(to.data(), from.data(), kBytes); });
    return {static_cast<double>(kRounds) * kChains * kLanes / fma, 2.0 * kBytes / copy};
}

}  // namespace splat
