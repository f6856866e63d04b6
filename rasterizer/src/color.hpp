// Colour of sixteen visible Gaussians from their SH coefficients, and its backward pass.
// `order` is the highest Fourier order used: a model constant in time has no cosine in its path.
#pragma once

#include "sh.hpp"

namespace splat {

// How a Gaussian is looked at.
struct Viewing {
    Float direction[3];  // unit, camera centre to μ(t)
    Float inverse_distance;
    Float turns;  // (t - μt)/T
};

SPLAT_INLINE Viewing viewing(const Float (&offset)[3], const Float& dt, float duration) {
    Viewing v;
    Float norm2 = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
    v.inverse_distance = Float(1.f) / sqrt(max(norm2, 1e-30f));
    for (int i = 0; i < 3; ++i) v.direction[i] = offset[i] * v.inverse_distance;
    v.turns = dt * Float(1.f / duration);
    return v;
}

template <int order>
struct Cosines {
    Float value[order + 1];
    SPLAT_INLINE explicit Cosines(const Float& turns) {
        value[0] = 1.f;
        if constexpr (order >= 1) value[1] = cos_turns(turns);
        if constexpr (order >= 2) value[2] = Float(2.f) * value[1] * value[1] - Float(1.f);
    }
};

// How far ahead coefficient rows are fetched, in Gaussians: the rows are the largest read of a frame and are
// not in order.
inline constexpr int kShPrefetch = 8;

SPLAT_INLINE void prefetch_sh(const Parameters& p, uint32_t id, int order) {
    const size_t row = static_cast<size_t>(p.stored_order + 1) * p.coefficients * 3;
    const char* at = reinterpret_cast<const char*>(p.sh + row * id);
    const int bytes = 4 * (order + 1) * p.coefficients * 3;
    for (int b = 0; b < bytes; b += 64) __builtin_prefetch(at + b);
}

// rgb before the clamp at zero: ½ + Σ k cos Y. ids[0..count-1] are the rows; next_ids what comes kShPrefetch
// later.
template <int order>
SPLAT_INLINE void color(const Parameters& p, const uint32_t* ids, int count, const uint32_t* next_ids,
                        const Viewing& view, int sh_degree, Float (&rgb)[3]) {
    const size_t order_stride = static_cast<size_t>(p.coefficients) * 3,
                 row_stride = order_stride * (p.stored_order + 1);
    Float basis[16], spread[kRowVectors][16];
    sh_basis(view.direction[0], view.direction[1], view.direction[2], sh_degree, basis);
    spread_basis(basis, spread);
    alignas(64) float cosine[order + 1][kLanes];
    Cosines<order> cosines(view.turns);
    for (int n = 1; n <= order; ++n) cosines.value[n].store(cosine[n]);
    for (int g = 0; g < count; ++g) {
        prefetch_sh(p, next_ids[g], order);
        const float* row = p.sh + row_stride * ids[g];
        ShRow sum = ShRow::load(row, p.coefficients);
        for (int n = 1; n <= order; ++n) {
            ShRow k = ShRow::load(row + order_stride * n, p.coefficients);
            for (int v = 0; v < kRowVectors; ++v) sum.v[v] += k.v[v] * Float(cosine[n][g]);
        }
        for (int v = 0; v < kRowVectors; ++v) spread[v][g] *= sum.v[v];
    }
    for (auto& c : rgb) c = 0.5f;
    for (int v = 0; v < kRowVectors; ++v) {
        transpose(spread[v]);
        for (int l = 0; l < kLanes; ++l) rgb[(v + l) % 3] += spread[v][l];
    }
}

// From ∂L/∂rgb (zero where the colour was clamped): ∂L/∂(camera to μ(t)) and ∂L/∂dt. The coefficients' own
// gradient is left as a ColorGradient (sh_gradient.hpp expands it).
template <int order>
SPLAT_INLINE void color_backward(const Parameters& p, const uint32_t* ids, int count,
                                 const uint32_t* next_ids, const Viewing& view, float duration, int sh_degree,
                                 const Float (&d_rgb)[3], Float (&d_offset)[3], Float& d_dt) {
    const size_t order_stride = static_cast<size_t>(p.coefficients) * 3,
                 row_stride = order_stride * (p.stored_order + 1);
    Float channels[kRowVectors][16];
    spread_channels(d_rgb, channels);
    alignas(64) float cosine[order + 1][kLanes];
    Cosines<order> cosines(view.turns);
    for (int n = 1; n <= order; ++n) cosines.value[n].store(cosine[n]);
    Float d_cosine[order + 1][16];  // per Gaussian, before the sum over lanes
    Float basis[16], spread[kRowVectors][16];
    if constexpr (order > 0) {
        sh_basis(view.direction[0], view.direction[1], view.direction[2], sh_degree, basis);
        spread_basis(basis, spread);
    }
    for (int g = 0; g < kLanes; ++g) {
        if (g >= count) {
            for (int v = 0; v < kRowVectors; ++v) channels[v][g] = 0.f;
            for (int n = 1; n <= order; ++n) d_cosine[n][g] = 0.f;
            continue;
        }
        prefetch_sh(p, next_ids[g], order);
        const float* row = p.sh + row_stride * ids[g];
        ShRow sum = ShRow::load(row, p.coefficients);
        for (int n = 1; n <= order; ++n) {
            ShRow k = ShRow::load(row + order_stride * n, p.coefficients);
            Float d(0.f);
            for (int v = 0; v < kRowVectors; ++v) {
                sum.v[v] += k.v[v] * Float(cosine[n][g]);
                d += k.v[v] * channels[v][g] * spread[v][g];
            }
            d_cosine[n][g] = d;
        }
        for (int v = 0; v < kRowVectors; ++v) channels[v][g] *= sum.v[v];
    }
    Float d_basis[16];
    for (auto& d : d_basis) d = 0.f;
    for (int v = 0; v < kRowVectors; ++v) {
        transpose(channels[v]);
        for (int l = 0; l < kLanes; ++l) d_basis[(kLanes * v + l) / 3] += channels[v][l];
    }
    Float d_direction[3];
    sh_basis_backward(view.direction[0], view.direction[1], view.direction[2], sh_degree, d_basis,
                      d_direction);
    Float along = d_direction[0] * view.direction[0] + d_direction[1] * view.direction[1] +
                  d_direction[2] * view.direction[2];
    for (int i = 0; i < 3; ++i)
        d_offset[i] = (d_direction[i] - along * view.direction[i]) * view.inverse_distance;
    d_dt = 0.f;
    if constexpr (order > 0) {
        Float d_turns(0.f), sine = sin_turns(view.turns);
        for (int n = 1; n <= order; ++n) {
            transpose(d_cosine[n]);
            Float total(0.f);
            for (int l = 0; l < kLanes; ++l) total += d_cosine[n][l];
            Float sine_n = n == 1 ? sine : Float(2.f) * sine * cosines.value[1];
            d_turns -= Float(kTwoPi * n) * sine_n * total;
        }
        d_dt = d_turns * Float(1.f / duration);
    }
}

}  // namespace splat
