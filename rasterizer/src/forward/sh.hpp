// Colour of sixteen visible Gaussians from their SH and Fourier coefficients, and its Jacobian.
//
// `order` is the highest Fourier order used: colours constant in time need no cosine.
#pragma once

#include <algorithm>

#include "forward/sh_basis.hpp"

namespace splat {

// What a Gaussian's colour depends on besides its coefficients.
struct ViewDirection {
    Float direction[3];  // unit vector from the camera to μ(t)
    Float inverse_distance;
    Float phase;  // (t - μt)/T minus the nearest integer, in turns
};

SPLAT_INLINE ViewDirection view_direction(const Float (&offset)[3], const Float& phase) {
    ViewDirection v;
    Float norm2 = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2];
    v.inverse_distance = Float(1.f) / sqrt(max(norm2, 1e-30f));
    for (int i = 0; i < 3; ++i) v.direction[i] = offset[i] * v.inverse_distance;
    v.phase = phase;
    return v;
}

// cos(2πn phase) for n = 0 .. order.
template <int order>
struct Cosines {
    Float value[order + 1];
    SPLAT_INLINE explicit Cosines(const Float& phase) {
        value[0] = 1.f;
        if constexpr (order >= 1) value[1] = cos_turns(phase);
        if constexpr (order >= 2) value[2] = Float(2.f) * value[1] * value[1] - Float(1.f);
    }
};

// cos(2πn phase) and its derivative by dt = T · phase, per Gaussian.
template <int order>
struct FourierFactors {
    alignas(64) scalar cosine[order + 1][kLanes], cosine_dt[order + 1][kLanes];
    SPLAT_INLINE FourierFactors(const Float& phase, scalar duration) {
        const Cosines<order> c(phase);
        if constexpr (order >= 1) {
            const Float sine = sin_turns(phase), phase_dt(-kTwoPi / duration);
            c.value[1].store(cosine[1]);
            (phase_dt * sine).store(cosine_dt[1]);
            if constexpr (order >= 2) {
                c.value[2].store(cosine[2]);
                (Float(4.f) * phase_dt * sine * c.value[1]).store(cosine_dt[2]);  // sin 2a = 2 sin a cos a
            }
        }
    }
};

// Prefetches the coefficients of sixteen Gaussians, the largest read of a view.
//
// A core can wait for about a dozen cache lines at a time, and a Gaussian has up to nine. So one Gaussian is
// prefetched at a time, between the steps of the sixteen before: memory access and arithmetic overlap.
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

    SPLAT_INLINE void one() {
        if (left_ <= 0) return;
        const ShStored* row = sh_ + row_stride_ * *ids_;
        for (int n = 0; n < orders_; ++n, row += order_stride_)
            for (int i = 0; i < values_; i += kPerLine) __builtin_prefetch(row + i);
        ++ids_, --left_;
    }
    SPLAT_INLINE void rest() {
        while (left_ > 0) one();
    }

private:
    static constexpr int kPerLine = 64 / sizeof(ShStored);
    const ShStored* sh_;
    const uint32_t* ids_;
    int left_, orders_, values_;
    size_t order_stride_, row_stride_;
};

// A Gaussian's colour before the clamp at zero, and its Jacobian.
struct Color {
    Float rgb[3];
    Float wrt_offset[3][3];  // ∂rgb_c / ∂(μ(t) - camera position)_i
    Float wrt_dt[3];         // ∂rgb_c / ∂(t - μt)
};

// rgb = ½ + Σ k cos Y of Gaussians ids[0..count-1]. next: the Gaussians to prefetch meanwhile.
// differentiable: the Jacobian too, while the coefficients are in registers. The backward pass then reads one
// cache line per Gaussian instead of up to 576 bytes of coefficients again.
template <int order, bool differentiable>
SPLAT_INLINE void color_from_sh(const Parameters& p, const uint32_t* ids, int count, RowFetch next,
                                const ViewDirection& view, scalar duration, int sh_degree, Color& out) {
    const size_t order_stride = static_cast<size_t>(p.coefficients) * 3,
                 row_stride = order_stride * (p.stored_order + 1);
    const int used = std::min(p.coefficients, (sh_degree + 1) * (sh_degree + 1));
    const FourierFactors<order> time(view.phase, duration);
    // Σ_n k_n cos, and its derivative by dt. First a row per Gaussian; after the transposes a Float per
    // coefficient and channel, at 3 lm + c.
    Float sum[kRowVectors][kLanes], sum_dt[kRowVectors][kLanes];
    for (int g = 0; g < count; ++g) {
        const ShStored* row = p.sh + row_stride * ids[g];
        ShRow total = ShRow::load(row, used), total_dt;
        for (int n = 1; n <= order; ++n) {
            const ShRow k = ShRow::load(row + order_stride * n, used);
            for (int v = 0; v < kRowVectors; ++v) {
                total.v[v] += k.v[v] * Float(time.cosine[n][g]);
                if constexpr (differentiable)
                    total_dt.v[v] = n == 1 ? k.v[v] * Float(time.cosine_dt[n][g])
                                           : total_dt.v[v] + k.v[v] * Float(time.cosine_dt[n][g]);
            }
        }
        for (int v = 0; v < kRowVectors; ++v) {
            sum[v][g] = total.v[v];
            if constexpr (differentiable && order > 0) sum_dt[v][g] = total_dt.v[v];
        }
        if (g % 2) next.one();
    }
    const Float(&d)[3] = view.direction;
    Float basis[16];
    sh_basis(d[0], d[1], d[2], sh_degree, basis);
    for (int v = 0; v < kRowVectors; ++v) {
        for (int g = count; g < kLanes; ++g) sum[v][g] = 0.f;
        transpose(sum[v]);
        next.one();
    }
    auto coefficient = [](Float(&m)[kRowVectors][kLanes], int lm, int c) -> Float& {
        return m[(3 * lm + c) / kLanes][(3 * lm + c) % kLanes];
    };
    for (int c = 0; c < 3; ++c) {
        out.rgb[c] = 0.5f;
        for (int lm = 0; lm < 16; ++lm) out.rgb[c] += basis[lm] * coefficient(sum, lm, c);
    }
    if constexpr (differentiable) {
        for (int c = 0; c < 3; ++c) {
            Float weight[16], g[3];
            for (int lm = 0; lm < 16; ++lm) weight[lm] = coefficient(sum, lm, c);
            sh_basis_backward(d[0], d[1], d[2], sh_degree, weight, g);
            const Float radial = g[0] * d[0] + g[1] * d[1] + g[2] * d[2];  // the direction has unit length
            for (int i = 0; i < 3; ++i) out.wrt_offset[c][i] = (g[i] - radial * d[i]) * view.inverse_distance;
            out.wrt_dt[c] = 0.f;
            next.one();
        }
        if constexpr (order > 0) {
            for (int v = 0; v < kRowVectors; ++v) {
                for (int g = count; g < kLanes; ++g) sum_dt[v][g] = 0.f;
                transpose(sum_dt[v]);
                next.one();
            }
            for (int c = 0; c < 3; ++c)
                for (int lm = 0; lm < 16; ++lm) out.wrt_dt[c] += basis[lm] * coefficient(sum_dt, lm, c);
        }
    }
    next.rest();
}

}  // namespace splat
