// Prefetches what preprocess_backward.hpp will read and write of the next sixteen Gaussians.
//
// A core can wait for about two dozen cache lines at a time, and sixteen Gaussians have a hundred. So a few
// are prefetched at a time, between the steps of the sixteen before (W2h: an eighth of the stage's time).
#pragma once

#include "view_state.hpp"

namespace splat {

class NextLanes {
public:
    // Of splats splat_index .. splat_index + count - 1; count may be 0 or less.
    NextLanes(const ViewState& view, uint32_t splat_index, int count)
        : view_(view), splat_index_(splat_index), count_(std::clamp(count, 0, kLanes)) {
        for (int l = 0; l < count_; ++l) ids_[l] = view.splats[splat_index + l].id;
    }

    // One half of the intersections' gradients, 0 or 1.
    SPLAT_INLINE void intersection_gradients(int half) const {
        if (count_ == 0) return;
        const ViewState::GradientRange first = view_.gradient_range[splat_index_],
                                       last = view_.gradient_range[splat_index_ + count_ - 1];
        for (uint32_t k = first.begin + half; k < last.begin + last.count; k += 2)
            __builtin_prefetch(&view_.intersection_gradients[k]);
    }
    SPLAT_INLINE void color_jacobians() const {
        for (int l = 0; l < count_; ++l) __builtin_prefetch(&view_.color_jacobian[splat_index_ + l]);
    }
    // Rows of three or four floats. Every second: neighbours share a cache line.
    SPLAT_INLINE void rows(const scalar* rows, int width) const {
        for (int l = 0; l < count_; l += 2) __builtin_prefetch(rows + static_cast<size_t>(width) * ids_[l]);
    }
    SPLAT_INLINE void rows_to_write(scalar* rows, int width) const {
        for (int l = 0; l < count_; l += 2)
            __builtin_prefetch(rows + static_cast<size_t>(width) * ids_[l], 1);
    }

private:
    const ViewState& view_;
    uint32_t splat_index_;
    int count_;
    uint32_t ids_[kLanes];
};

}  // namespace splat
