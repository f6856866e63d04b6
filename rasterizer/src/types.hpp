// The data that goes from stage to stage, and the numbers the method fixes (docs/method.md 1).
#pragma once

#include <cstddef>
#include <cstdint>

#include "choices.hpp"

namespace splat {

inline constexpr scalar kDilation = 0.3;       // px² added to the 2D covariance's diagonal
inline constexpr scalar kFrustumMargin = 1.3;  // x/z and y/z are clamped to so many half fields of view
inline constexpr scalar kMaxAlpha = 0.99;

inline constexpr int kTile = 16;  // a tile is 16×16 pixels ...
inline constexpr int kBlock =
    4;  // ... made of sixteen 4×4 blocks, a block's pixels being the lanes of a Float
inline constexpr int kBlocks = 16;  // 8×8 tiles have 1.7× the entries; 16×1 and 8×2 blocks lose too

// What a model has; what it does not have is not compiled into its path.
enum class Motion {
    kStatic,     // no time: ordinary 3D Gaussian Splatting
    kSeparable,  // time apart from space: no 4D rotation
    kFull,       // 4D rotation
};

// The stored parameters (before activation), row-major.
struct Parameters {
    uint32_t count;
    const scalar* mean;           // [N, 4], static [N, 3]
    const scalar* log_scale;      // [N, 4], static [N, 3]
    const scalar* quat_left;      // [N, 4]
    const scalar* quat_right;     // [N, 4], full motion only
    const scalar* opacity_logit;  // [N]
    const ShStored* sh;           // [N, (stored_order + 1) · coefficients, 3]
    int coefficients;             // per Fourier order: 1, 4, 9 or 16
    int stored_order;             // Fourier orders stored beyond 0
};

// A pinhole and the moment it looks at, in single or double. With Scalar = float, centre and time have a
// second float each for what the first cannot hold: μ - centre and t - μt keep their digits far from any
// origin.
template <class Scalar>
struct CameraOf {
    int width, height;
    Scalar fx, fy, cx, cy;
    Scalar rotation[3][3];  // world to camera
    Scalar position[3], position_low[3];
    Scalar time, time_low;
};
using Camera = CameraOf<scalar>;

inline Camera rounded(const CameraOf<double>& c) {
    Camera r{c.width,
             c.height,
             static_cast<scalar>(c.fx),
             static_cast<scalar>(c.fy),
             static_cast<scalar>(c.cx),
             static_cast<scalar>(c.cy),
             {},
             {},
             {},
             0.f,
             0.f};
    auto split = [](double x, scalar& high, scalar& low) {
        high = static_cast<scalar>(x);
        low = static_cast<scalar>(x - static_cast<double>(high));
    };
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) r.rotation[i][j] = static_cast<scalar>(c.rotation[i][j]);
        split(c.position[i], r.position[i], r.position_low[i]);
    }
    split(c.time, r.time, r.time_low);
    return r;
}

// What is asked of a frame.
struct Settings {
    double duration;
    scalar near_plane;
    scalar background[3];
    scalar flow_dt;
    int sh_degree;      // degrees above it are left out
    int fourier_order;  // orders above it are left out
    bool depth, flow, stats;
    bool differentiable;  // a backward pass will follow
    int threads;

    int extra_channels() const { return depth + 2 * flow + 2 * stats; }
};

inline constexpr int kMaxExtra = 5;

// One Gaussian on the screen: one cache line of floats, all that blending reads.
struct alignas(64) Splat {
    scalar x, y;  // pixel coordinates of the mean; pixel (i, j)'s centre is at (i, j) here
    // log2 of alpha at (px, py): log2_opacity + across (px - intercept + lean py)² + along (py - y)²
    scalar intercept, lean, across, along;
    scalar log2_opacity;  // of opacity · p(t)
    scalar r, g, b;
    scalar depth;                    // z in the camera's frame
    scalar half_width, half_height;  // of the box round the alpha >= 1/255 ellipse, pixels
    scalar radius;                   // 3 standard deviations along the longer axis, pixels
    uint32_t id;                     // row in the parameters
    uint32_t unused;
};
static_assert(sizeof(Splat) == 16 * sizeof(scalar));

// How a visible Gaussian's colour changes with what it is seen from and when, kept from forward to backward
// pass. One cache line.
struct alignas(64) ColorSlope {
    scalar by_offset[3][3];  // ∂rgb_c / ∂(camera centre to μ(t))_i
    scalar by_dt[3];         // ∂rgb_c / ∂(t - μt)
    scalar shown[3];         // 0 where rgb_c was negative and is shown as 0, else 1
    scalar unused;
};
static_assert(sizeof(ColorSlope) == 16 * sizeof(scalar));

// The gradient a (tile, Gaussian) entry collects; entries of one Gaussian are added in a fixed order. One
// cache line.
struct alignas(64) Slot {
    scalar value[16];
};
enum SlotField {
    kSlotR,
    kSlotG,
    kSlotB,
    kSlotPower,
    kSlotAcross,
    kSlotAlong,
    kSlotAcross2,
    kSlotBoth,
    kSlotAlong2,
    kSlotExtra
};
inline constexpr int kSlotFields = 9;
static_assert(kSlotFields + kMaxExtra <= 16);

// The colour gradient of one visible Gaussian in one view: all that the gradient of its up to 144 SH
// coefficients needs, ∂L/∂k_nlm = color ⊗ Y_lm(direction) · cos(2πn dt/T). Never expanded per view.
struct ColorGradient {
    scalar color[3];
    scalar direction[3];
    scalar cosine[2];  // of Fourier orders 1 and 2
};

// Gradients of the parameters, added to; same shapes as the parameters.
struct ParameterGradients {
    scalar* mean;
    scalar* log_scale;
    scalar* quat_left;
    scalar* quat_right;
    scalar* opacity_logit;
};

}  // namespace splat
