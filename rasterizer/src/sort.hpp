// Stage 2: the visible Gaussians front to back, by float32 depths, far ones (far.hpp) by double ones. Equal
// depths keep the order of their ids.
#pragma once

#include <algorithm>
#include <bit>
#include <utility>
#include <vector>

#include "far.hpp"
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
// differ. Returns which of the two buffers holds the result.
inline int sort_by_bits(Frame& f, Frame::DepthBits nearest, Frame::DepthBits farthest) {
    const uint32_t n = f.visible;
    const int threads = f.settings.threads;
    if (n == 0 || nearest == farthest) return 0;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (uint32_t i = 0; i < n; ++i) f.keys[0][i].bits -= nearest;
    const int key_bits = std::bit_width(farthest - nearest),
              passes = (key_bits + kMaxDigitBits - 1) / kMaxDigitBits;
    const int digit_bits = (key_bits + passes - 1) / passes;
    for (int pass = 0; pass < passes; ++pass)
        counting_pass(f.keys[pass & 1].data(), f.keys[~pass & 1].data(), n, pass * digit_bits, digit_bits,
                      threads);
    return passes & 1;
}

// Far Gaussians of one float32 depth are ordered by what it leaves over of theirs. Only ties are looked at:
// the radix keys stay four bytes.
inline void order_far_ties(const Frame& f, Frame::DepthKey* keys) {
    using Key = Frame::DepthKey;
    const scalar beyond = far_depth(f.settings);
    Key* const end = keys + f.visible;
    Key* first = std::partition_point(keys, end, [&](const Key& k) { return f.depth[k.place] <= beyond; });
    while (first != end) {
        Key* const last = std::find_if(first, end, [&](const Key& k) { return k.bits != first->bits; });
        std::sort(first, last, [&](const Key& a, const Key& b) {
            const scalar x = f.depth_low[a.place], y = f.depth_low[b.place];
            return x < y || (x == y && a.place < b.place);
        });
        first = last;
    }
}

inline void sort_by_depth(Frame& f) {
    StageTimer timer(f, kStageSort);
    for (auto& keys : f.keys) keys.resize(f.visible);
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
    Frame::DepthKey* const sorted = f.keys[sort_by_bits(f, nearest, farthest)].data();
    if (f.visible && std::bit_cast<scalar>(farthest) > far_depth(f.settings)) order_far_ties(f, sorted);
    f.front_to_back = sorted;
}

}  // namespace splat
