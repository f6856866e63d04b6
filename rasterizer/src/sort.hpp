// Stage 2: the visible Gaussians front to back. Equal depths keep the order of their ids.
#pragma once

#include <algorithm>
#include <bit>
#include <utility>
#include <vector>

#include "frame.hpp"

namespace splat {

inline constexpr int kMaxDigitBits = 12;  // 4096 counters stay in the first-level cache

// One stable counting pass over a digit. Each thread counts and scatters its own share of the keys, the
// shares in order: the same result for any number of threads.
inline void counting_pass(const Frame::DepthKey* from, Frame::DepthKey* to, uint32_t n, int shift,
                          int digit_bits, int threads) {
    const uint32_t digits = 1u << digit_bits;
    std::vector<uint32_t> first(static_cast<size_t>(threads) * digits, 0);
    auto share = [&](int t) { return static_cast<uint32_t>(static_cast<uint64_t>(n) * t / threads); };
    auto digit = [&](uint32_t i) { return from[i].bits >> shift & (digits - 1); };
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int t = 0; t < threads; ++t)
        for (uint32_t i = share(t); i < share(t + 1); ++i) ++first[t * digits + digit(i)];
    uint32_t total = 0;
    for (uint32_t d = 0; d < digits; ++d)
        for (int t = 0; t < threads; ++t) total += std::exchange(first[t * digits + d], total);
#pragma omp parallel for schedule(static, 1) num_threads(threads)
    for (int t = 0; t < threads; ++t)
        for (uint32_t i = share(t); i < share(t + 1); ++i) to[first[t * digits + digit(i)]++] = from[i];
}

// The bits of a positive float sort as it does; only as many passes as the bits in which the view's depths
// differ.
inline void sort_by_depth(Frame& f) {
    StageTimer timer(f, kStageSort);
    const uint32_t n = f.visible;
    for (auto& keys : f.keys) keys.resize(n);
    const int chunks = static_cast<int>(f.chunk_count.size()), threads = f.settings.threads;
    Frame::DepthBits nearest = ~Frame::DepthBits{0}, farthest = 0;
#pragma omp parallel for schedule(static) num_threads(threads) reduction(min : nearest) \
    reduction(max : farthest)
    for (int c = 0; c < chunks; ++c) {
        const uint32_t place = static_cast<uint32_t>(c) * kChunk;
        for (uint32_t i = 0; i < f.chunk_count[c]; ++i) {
            const auto bits = std::bit_cast<Frame::DepthBits>(f.depth[place + i]);
            f.keys[0][f.chunk_first[c] + i] = {bits, place + i};
            nearest = std::min(nearest, bits), farthest = std::max(farthest, bits);
        }
    }
    f.front_to_back = f.keys[0].data();
    if (n == 0 || nearest == farthest) return;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (uint32_t i = 0; i < n; ++i) f.keys[0][i].bits -= nearest;
    const int key_bits = std::bit_width(farthest - nearest),
              passes = (key_bits + kMaxDigitBits - 1) / kMaxDigitBits;
    const int digit_bits = (key_bits + passes - 1) / passes;
    for (int pass = 0; pass < passes; ++pass)
        counting_pass(f.keys[pass & 1].data(), f.keys[~pass & 1].data(), n, pass * digit_bits, digit_bits,
                      threads);
    f.front_to_back = f.keys[passes & 1].data();
}

}  // namespace splat
