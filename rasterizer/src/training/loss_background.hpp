// Blocks of the loss in which image and target show only the background. They all have the same values,
// so the first is computed as ever and the others copy it: the same bits. The loss then takes 0.36 (AVX2)
// to 0.42 (AVX-512) of its time on D-NeRF's mutant, of whose pixels 89 % are black, and 0.48 to 0.54 on
// lego. Looking for the background costs up to 4 %, and nothing where image and target differ in the
// first pixel.
//
// That pixel is the background's colour, if they agree on it. A block is kLanes columns by kRows rows.
// Outside the image are zeros, so that a black background goes on there and any other ends. The partial
// derivatives outside are zero, which is no background's value.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "simd/vec.hpp"

namespace splat {

// A value of the background for each of `maps` maps, once a block has it.
template <int maps>
struct BackgroundValue {
    bool known = false;
    std::array<Float, maps> of;
    void set(const std::array<Float, maps>& value) { known = true, of = value; }
};

class LossBackground {
public:
    // first_row: the first that will be read, above the image or in it.
    // enabled: false computes every block, for the tests.
    LossBackground(const scalar* image, const scalar* target, int width, int height, int first_row,
                   bool enabled)
        : image_(image),
          target_(target),
          width_(width),
          height_(height),
          unread_(first_row),
          color_(image[0]),
          agreed_(enabled && image[0] == target[0]),
          blocks_((width + kLanes - 1) / kLanes),
          is_background_(blocks_ + 4, agreed_ && color_ == 0),
          other_row_(blocks_, agreed_ ? kNone : kAll),
          other_partial_(other_row_) {}

    // Finds the blocks whose columns, in rows [first, end), are background; rows only go down.
    void find(int first, int end) {
        read_rows(end);
        for (int b = 0; b < blocks_; ++b) is_background_[b + 2] = other_row_[b] < first;
    }
    // Likewise for the partial derivatives.
    void find_in_partials(int first, int end) {
        const bool inside = first >= 0 && end <= height_;
        for (int b = 0; b < blocks_; ++b) is_background_[b + 2] = inside && other_partial_[b] < first;
    }
    void partials_differ(int b, int row) { other_partial_[b] = row; }

    // Of what was last found. Whether block b is background: filtering its columns gives the background's
    // values. Whether the blocks beside it are too: so does filtering its rows. Whether that holds for all
    // blocks that read b's filtered columns: then nobody does.
    bool at(int b) const { return is_background_[b + 2]; }
    bool around(int b) const { return at(b - 1) && at(b) && at(b + 1); }
    bool far_around(int b) const { return at(b - 2) && around(b) && at(b + 2); }

    BackgroundValue<4> mean;              // filtered along columns
    BackgroundValue<4> ssim_and_partial;  // SSIM, then its partial derivatives
    BackgroundValue<3> filtered_partial;  // filtered along columns
    BackgroundValue<1> gradient;

private:
    static constexpr int kNone = std::numeric_limits<int>::min(), kAll = std::numeric_limits<int>::max();

    // Looks at the rows up to `end` that have not been looked at.
    void read_rows(int end) {
        if (!agreed_) return;
        for (; unread_ < end; ++unread_) {
            const bool inside = unread_ >= 0 && unread_ < height_;
            if (!inside && color_ == 0) continue;
            const size_t at = static_cast<size_t>(inside ? unread_ : 0) * width_;
            for (int i = 0, b = 0; i < width_; i += kLanes, ++b)
                if (!inside || !shows_background(at + i, std::min(kLanes, width_ - i)))
                    other_row_[b] = unread_;
        }
    }

    SPLAT_INLINE bool shows_background(size_t at, int count) const {
        // One pixel first: where there is no background, it is all that is read.
        if (!(image_[at] == color_ && target_[at] == color_)) return false;
        const Float x = Float::load_first(image_ + at, count), y = Float::load_first(target_ + at, count);
        const Float c(color_);
        return bits((x >= c) & (x <= c) & (y >= c) & (y <= c)) == (1u << kLanes) - 1;
    }

    const scalar *image_, *target_;
    int width_, height_, unread_;
    scalar color_;
    bool agreed_;
    int blocks_;
    std::vector<uint8_t> is_background_;  // of each block, with two blocks of the zeros on both sides
    // The last row of each block that is not background: of image and target, and of the partial derivatives.
    std::vector<int> other_row_, other_partial_;
};

}  // namespace splat
