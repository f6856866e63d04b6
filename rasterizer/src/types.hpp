// The data that stages pass to each other, and the constants that the method fixes (docs/method.md 1).
#pragma once

#include <cstddef>
#include <cstdint>

#include "numerical_choices.hpp"

namespace splat {

inline constexpr scalar kDilation = 0.3;       // px² added to the 2D covariance's diagonal
inline constexpr scalar kFrustumMargin = 1.3;  // x/z and y/z are clamped to this many half fields of view
inline constexpr scalar kMaxAlpha = 0.99;

// A tile is 16×16 pixels, made of sixteen 4×4 blocks. The pixels of a block are the lanes of a Float.
// Measured alternatives are slower: 8×8 tiles have 1.7 times the intersections; so are 16×1 and 8×2 blocks.
inline constexpr int kTile = 16;
inline constexpr int kBlock = 4;
inline constexpr int kBlocks = 16;

// The kind of model. Each kind is compiled separately, without code for what it lacks.
enum class Motion {
    kStatic,     // no time: 3D Gaussian Splatting
    kSeparable,  // a temporal marginal and no 4D rotation; moves with a velocity of its own, if it has one
    kFull,       // 4D rotation, which makes Gaussians move
};

// A trajectory at the time of a view: displacement [3], rotation vector [3], drift [3], and zeros up to a
// vector's width.
inline constexpr int kTrajectoryValues = 9, kTrajectoryColumns = 16;

// The stored parameters (before activation), row-major.
struct Parameters {
    uint32_t count;
    const scalar* mean;           // [N, 4], static [N, 3]
    const scalar* log_scale;      // [N, 4], static [N, 3]
    const scalar* quat_left;      // [N, 4]
    const scalar* quat_right;     // [N, 4], full motion only
    const scalar* velocity;       // [N, 3], separable motion; null: nothing moves
    const scalar* opacity_logit;  // [N]
    const ShStored* sh;           // [N, (stored_order + 1) · coefficients, 3]
    int coefficients;             // per Fourier order: 1, 4, 9 or 16
    int stored_order;             // highest Fourier order stored
    const scalar* weights;        // [N, K] of the shared trajectories, separable motion; null: there are none
    const scalar* trajectories;   // [K, kTrajectoryColumns] at the time of the view (shared_motion.hpp)
    int trajectory_count;         // K
};

// The camera at the later time of the optical flow, relative to that of the view.
template <class Scalar>
struct FlowCamera {
    Scalar rotation[3][3];                     // world to camera
    Scalar shift[3];                           // the view's position less the later one, world axes
    Scalar focal_change[2], centre_change[2];  // later less now, pixels
    bool moved;
};

// A pinhole camera and the time of the view, in float or double. With Scalar = float, position and time are
// each a sum of two floats: μ - position and t - μt then keep their digits far from the origin.
template <class Scalar>
struct CameraOf {
    int width, height;
    Scalar fx, fy, cx, cy;
    Scalar rotation[3][3];  // world to camera
    Scalar position[3], position_low[3];
    Scalar time, time_low;
    Scalar marginal_offset;  // p is that of time + this
    FlowCamera<Scalar> flow_camera;
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
             0.f,
             static_cast<scalar>(c.marginal_offset),
             {}};
    auto split = [](double x, scalar& high, scalar& low) {
        high = static_cast<scalar>(x);
        low = static_cast<scalar>(x - static_cast<double>(high));
    };
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) r.rotation[i][j] = static_cast<scalar>(c.rotation[i][j]);
        split(c.position[i], r.position[i], r.position_low[i]);
    }
    split(c.time, r.time, r.time_low);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j)
            r.flow_camera.rotation[i][j] = static_cast<scalar>(c.flow_camera.rotation[i][j]);
        r.flow_camera.shift[i] = static_cast<scalar>(c.flow_camera.shift[i]);
    }
    for (int a = 0; a < 2; ++a) {
        r.flow_camera.focal_change[a] = static_cast<scalar>(c.flow_camera.focal_change[a]);
        r.flow_camera.centre_change[a] = static_cast<scalar>(c.flow_camera.centre_change[a]);
    }
    r.flow_camera.moved = c.flow_camera.moved;
    return r;
}

// What to render.
struct Settings {
    double duration;
    scalar near_plane;
    scalar background[3];
    scalar flow_dt;
    int sh_degree;      // highest SH degree used
    int fourier_order;  // highest Fourier order used
    bool depth, flow, stats;
    bool differentiable;  // a backward pass will follow
    bool detached;        // colour gives no gradient to positions and times (docs/baseline.md)
    int threads;

    int extra_channels() const { return depth + 2 * flow + 2 * stats; }
};

inline constexpr int kMaxExtraChannels = 5;

// A projected Gaussian: all that blending reads, in one cache line (of floats).
struct alignas(64) Splat {
    scalar x, y;  // mean2d in pixels; the centre of pixel (i, j) is (i, j) here
    // The conic as two squares (project_ewa.hpp): with u = px - sheared_x + shear py and v = py - y,
    //     log2 alpha(px, py) = log2_opacity + conic_u u² + conic_v v².
    scalar sheared_x, shear, conic_u, conic_v;
    scalar log2_opacity;  // of opacity · p(t)
    scalar r, g, b;
    scalar depth;                    // z in camera axes
    scalar half_width, half_height;  // bounding box of the alpha >= 1/255 ellipse, pixels
    scalar radius;                   // 3 standard deviations along the major axis, pixels
    uint32_t id;                     // row in the parameters
    uint32_t unused;
};
static_assert(sizeof(Splat) == 16 * sizeof(scalar));

// Derivatives of a visible Gaussian's colour by its position and time, from the forward to the backward pass.
// One cache line.
struct alignas(64) ColorJacobian {
    scalar wrt_offset[3][3];  // ∂rgb_c / ∂(μ(t) - camera position)_i
    scalar wrt_dt[3];         // ∂rgb_c / ∂(t - μt)
    scalar not_clamped[3];    // 0 where rgb_c was negative and clamped to 0, else 1
    scalar unused;
};
static_assert(sizeof(ColorJacobian) == 16 * sizeof(scalar));

// The gradient of one (tile, splat) intersection, by GradientField. Those of a splat are added up in a fixed
// order. One cache line.
struct alignas(64) IntersectionGradient {
    scalar value[16];
};
// With δ = ∂L/∂ln(alpha) of a pixel and u, v as in Splat, summed over the tile's pixels:
enum GradientField {
    kGradR,
    kGradG,
    kGradB,
    kGradLogAlpha,  // Σ δ
    kMomentU,       // Σ δ u
    kMomentV,       // Σ δ v
    kMomentUU,      // Σ δ u²
    kMomentUV,      // Σ δ u v
    kMomentVV,      // Σ δ v²
    kGradExtra      // ∂L/∂ of depth, flow and statistics, as far as rendered
};
inline constexpr int kGradientFields = 9;
static_assert(kGradientFields + kMaxExtraChannels <= 16);

// The colour gradient of one visible Gaussian in one view. The gradient of its up to 144 SH coefficients is
// an outer product of it: ∂L/∂k_nlm = color ⊗ Y_lm(direction) · cos(2πn dt/T), which is not stored per view.
struct ColorGradient {
    scalar color[3];
    scalar direction[3];
    scalar cosine[2];  // of Fourier orders 1 and 2
};

// Gradients of the parameters, in the parameters' shapes. The backward pass adds to them.
struct ParameterGradients {
    scalar* mean;
    scalar* log_scale;
    scalar* quat_left;
    scalar* quat_right;
    scalar* velocity;
    scalar* opacity_logit;
    scalar* weights;
    scalar* trajectories;  // [K, kTrajectoryColumns]
};

}  // namespace splat
