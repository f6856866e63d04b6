// Stage 2, sort: the visible splats front to back, by a radix sort of their depths.
//
// Depths are compared in float32, distant ones in double (depth_in_double.hpp). Equal depths keep the order
// of ids.
#pragma once

#include <algorithm>
#include <bit>
#include <utility>
#include <vector>

#include "forward/depth_in_double.hpp"
#include "view_state.hpp"

namespace splat {

inline constexpr int kMaxDigitBits = 12;  // 4096 counters stay in the first-level cache

// One stable pass of the radix sort. Each thread counts and scatters its own share of the keys; the shares
// are in order, so the result is the same for any number of threads.
inline void counting_pass(const ViewState::DepthKey* from, ViewState::DepthKey* to, uint32_t n, int shift,
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

// Positive floats sort as their bits do. Only the bits in which the view's depths differ are sorted. Returns
// which of the two buffers holds the result.
inline int sort_by_bits(ViewState& view, ViewState::DepthBits nearest, ViewState::DepthBits farthest) {
    const uint32_t n = view.visible;
    const int threads = view.settings.threads;
    if (n == 0 || nearest == farthest) return 0;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (uint32_t i = 0; i < n; ++i) view.keys[0][i].bits -= nearest;
    const int key_bits = std::bit_width(farthest - nearest),
              passes = (key_bits + kMaxDigitBits - 1) / kMaxDigitBits;
    const int digit_bits = (key_bits + passes - 1) / passes;
    for (int pass = 0; pass < passes; ++pass)
        counting_pass(view.keys[pass & 1].data(), view.keys[~pass & 1].data(), n, pass * digit_bits,
                      digit_bits, threads);
    return passes & 1;
}

// Orders distant splats of equal float32 depth by the rest of their depth in double. Only ties need it, so
// the keys of the radix sort stay four bytes.
inline void order_ties_in_double(const ViewState& view, ViewState::DepthKey* keys) {
    using Key = ViewState::DepthKey;
    const scalar double_from = double_depth_from(view.settings);
    Key* const end = keys + view.visible;
    Key* first = std::partition_point(keys, end,
                                      [&](const Key& k) { return view.depth[k.splat_index] <= double_from; });
    while (first != end) {
        Key* const last = std::find_if(first, end, [&](const Key& k) { return k.bits != first->bits; });
        std::sort(first, last, [&](const Key& a, const Key& b) {
            const scalar x = view.depth_low[a.splat_index], y = view.depth_low[b.splat_index];
            return x < y || (x == y && a.splat_index < b.splat_index);
        });
        first = last;
    }
}

inline void sort_by_depth(ViewState& view) {
    StageTimer timer(view, kStageSort);
    for (auto& keys : view.keys) keys.resize(view.visible);
    const int chunks = static_cast<int>(view.chunk_count.size()), threads = view.settings.threads;
    ViewState::DepthBits nearest = ~ViewState::DepthBits{0}, farthest = 0;
#pragma omp parallel for schedule(static) num_threads(threads) reduction(min : nearest) \
    reduction(max : farthest)
    for (int c = 0; c < chunks; ++c) {
        const uint32_t splat_index = static_cast<uint32_t>(c) * kChunk;
        for (uint32_t i = 0; i < view.chunk_count[c]; ++i) {
            const auto bits = std::bit_cast<ViewState::DepthBits>(view.depth[splat_index + i]);
            view.keys[0][view.chunk_first[c] + i] = {bits, splat_index + i};
            nearest = std::min(nearest, bits), farthest = std::max(farthest, bits);
        }
    }
    ViewState::DepthKey* const sorted = view.keys[sort_by_bits(view, nearest, farthest)].data();
    if (view.visible && std::bit_cast<scalar>(farthest) > double_depth_from(view.settings))
        order_ties_in_double(view, sorted);
    view.front_to_back = sorted;
}

}  // namespace splat
