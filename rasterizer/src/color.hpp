// Colour of sixteen visible Gaussians from their SH coefficients, and its derivatives.
// `order` is the highest Fourier order used: a model constant in time has no cosine in its path.
#pragma once

#include <algorithm>

#include "sh.hpp"

namespace splat {

// How a Gaussian is looked at.
struct Viewing {
    Float direction[3];  // unit, camera centre to μ(t)
    Float inverse_distance;
    Float turns;  // (t - μt)/T less the nearest integer
};

SPLAT_INLINE Viewing viewing(const Float (&offset)[3], const Float& turns) {
    Viewing v;
    Float norm2 = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
    v.inverse_distance = Float(1.f) / sqrt(max(norm2, 1e-30f));
    for (int i = 0; i < 3; ++i) v.direction[i] = offset[i] * v.inverse_distance;
    v.turns = turns;
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

// cos(2πn turns) and its derivative by dt = T · turns, per Gaussian.
template <int order>
struct TimeFactors {
    alignas(64) scalar cosine[order + 1][kLanes], slope[order + 1][kLanes];
    SPLAT_INLINE TimeFactors(const Float& turns, scalar duration) {
        const Cosines<order> c(turns);
        if constexpr (order >= 1) {
            const Float sine = sin_turns(turns), rate(-kTwoPi / duration);
            c.value[1].store(cosine[1]);
            (rate * sine).store(slope[1]);
            if constexpr (order >= 2) {
                c.value[2].store(cosine[2]);
                (Float(4.f) * rate * sine * c.value[1]).store(slope[2]);  // sin 2a = 2 sin a cos a
            }
        }
    }
};

// Sixteen coefficient rows on their way to the first-level cache: the largest read of a frame.
//
// A core waits for a dozen lines at a time and a row is up to nine, so rows are asked for two at a time
// between the steps of the sixteen Gaussians before: memory then works while the core does.
class RowFetch {
public:
    RowFetch(const Parameters& p, const uint32_t* ids, int count, int order, int coefficients)
        : sh_(p.sh),
          ids_(ids),
          left_(count),
          orders_(order + 1),
          values_(3 * coefficients),
          order_stride_(static_cast<size_t>(p.coefficients) * 3),
          row_stride_(order_stride_ * (p.stored_order + 1)) {}

    SPLAT_INLINE void two_rows() {
        for (int k = 0; k < 2 && left_ > 0; ++k, ++ids_, --left_) {
            const ShStored* row = sh_ + row_stride_ * *ids_;
            for (int n = 0; n < orders_; ++n, row += order_stride_)
                for (int i = 0; i < values_; i += kPerLine) __builtin_prefetch(row + i);
        }
    }
    SPLAT_INLINE void rest() {
        while (left_ > 0) two_rows();
    }

private:
    static constexpr int kPerLine = 64 / sizeof(ShStored);
    const ShStored* sh_;
    const uint32_t* ids_;
    int left_, orders_, values_;
    size_t order_stride_, row_stride_;
};

// A Gaussian's colour before the clamp at zero, and what it depends on besides the coefficients.
struct Color {
    Float rgb[3];
    Float by_offset[3][3];  // ∂rgb_c / ∂(camera centre to μ(t))_i
    Float by_dt[3];         // ∂rgb_c / ∂(t - μt)
};

// rgb = ½ + Σ k cos Y. ids[0..count-1] are the rows; next: those of the Gaussians after them. With
// `differentiable` the derivatives are taken while the coefficients are at hand, a cache line a Gaussian kept
// instead of 576 read again by the backward pass.
template <int order, bool differentiable>
SPLAT_INLINE void color(const Parameters& p, const uint32_t* ids, int count, RowFetch next,
                        const Viewing& view, scalar duration, int sh_degree, Color& out) {
    const size_t order_stride = static_cast<size_t>(p.coefficients) * 3,
                 row_stride = order_stride * (p.stored_order + 1);
    const int used = std::min(p.coefficients, (sh_degree + 1) * (sh_degree + 1));
    const TimeFactors<order> time(view.turns, duration);
    // Σ_n k_n cos, and its derivative by dt; first a row a Gaussian, after the transposes a Float a
    // coefficient and channel: entry 3 lm + c
    Float sum[kRowVectors][kLanes], by_dt[kRowVectors][kLanes];
    for (int g = 0; g < count; ++g) {
        const ShStored* row = p.sh + row_stride * ids[g];
        ShRow total = ShRow::load(row, used), slope;
        for (int n = 1; n <= order; ++n) {
            const ShRow k = ShRow::load(row + order_stride * n, used);
            for (int v = 0; v < kRowVectors; ++v) {
                total.v[v] += k.v[v] * Float(time.cosine[n][g]);
                if constexpr (differentiable)
                    slope.v[v] = n == 1 ? k.v[v] * Float(time.slope[n][g])
                                        : slope.v[v] + k.v[v] * Float(time.slope[n][g]);
            }
        }
        for (int v = 0; v < kRowVectors; ++v) {
            sum[v][g] = total.v[v];
            if constexpr (differentiable && order > 0) by_dt[v][g] = slope.v[v];
        }
    }
    const Float(&d)[3] = view.direction;
    Float basis[16];
    sh_basis(d[0], d[1], d[2], sh_degree, basis);
    for (int v = 0; v < kRowVectors; ++v) {
        for (int g = count; g < kLanes; ++g) sum[v][g] = 0.f;
        transpose(sum[v]);
        next.two_rows();
    }
    auto entry = [](Float(&m)[kRowVectors][kLanes], int lm, int c) -> Float& {
        return m[(3 * lm + c) / kLanes][(3 * lm + c) % kLanes];
    };
    for (int c = 0; c < 3; ++c) {
        out.rgb[c] = 0.5f;
        for (int lm = 0; lm < 16; ++lm) out.rgb[c] += basis[lm] * entry(sum, lm, c);
    }
    if constexpr (differentiable) {
        for (int c = 0; c < 3; ++c) {
            Float weight[16], g[3];
            for (int lm = 0; lm < 16; ++lm) weight[lm] = entry(sum, lm, c);
            sh_basis_backward(d[0], d[1], d[2], sh_degree, weight, g);
            const Float along = g[0] * d[0] + g[1] * d[1] + g[2] * d[2];  // the direction stays a unit vector
            for (int i = 0; i < 3; ++i) out.by_offset[c][i] = (g[i] - along * d[i]) * view.inverse_distance;
            out.by_dt[c] = 0.f;
            next.two_rows();
        }
        if constexpr (order > 0) {
            for (int v = 0; v < kRowVectors; ++v) {
                for (int g = count; g < kLanes; ++g) by_dt[v][g] = 0.f;
                transpose(by_dt[v]);
                next.two_rows();
            }
            for (int c = 0; c < 3; ++c)
                for (int lm = 0; lm < 16; ++lm) out.by_dt[c] += basis[lm] * entry(by_dt, lm, c);
        }
    }
    next.rest();
}

}  // namespace splat
