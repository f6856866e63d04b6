// Real spherical harmonics up to degree 3, their derivatives, and rows of SH coefficients in vectors.
//
// The colour (4D spherindrical harmonics, paper eq. 8) is, with the signs of 3D Gaussian Splatting's real SH,
//     colour = max(0, ½ + Σ_n cos(2πn (t-μt)/T) Σ_lm k_nlm Y_lm(d)).
//
// A row of coefficients is 48 floats for each Fourier order, [lm][rgb]: three Floats, in which lane l of
// Float v is coefficient (16 v + l) / 3, channel (v + l) mod 3. The basis is spread the same way, so that one
// multiplication serves three channels and memory is read in order.
#pragma once

#include "simd/half_precision.hpp"
#include "simd/vec_math.hpp"
#include "simd/vec_move.hpp"
#include "types.hpp"

namespace splat {

inline constexpr scalar kShC0 = 0.28209479177387814;
inline constexpr scalar kShC1 = 0.4886025119029199;
inline constexpr scalar kShC2[5] = {1.0925484305920792, -1.0925484305920792, 0.31539156525252005,
                                    -1.0925484305920792, 0.5462742152960396};
inline constexpr scalar kShC3[7] = {-0.5900435899266435, 2.890611442640554,   -0.4570457994644658,
                                    0.3731763325901154,  -0.4570457994644658, 1.445305721320277,
                                    -0.5900435899266435};

// Y_lm of the unit direction (x, y, z), zero above `degree`.
SPLAT_INLINE void sh_basis(const Float& x, const Float& y, const Float& z, int degree, Float (&b)[16]) {
    for (auto& v : b) v = 0.f;
    b[0] = kShC0;
    if (degree < 1) return;
    b[1] = Float(-kShC1) * y, b[2] = Float(kShC1) * z, b[3] = Float(-kShC1) * x;
    if (degree < 2) return;
    Float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    const Float two(2.f), three(3.f), four(4.f);
    b[4] = Float(kShC2[0]) * xy, b[5] = Float(kShC2[1]) * yz, b[6] = Float(kShC2[2]) * (two * zz - xx - yy);
    b[7] = Float(kShC2[3]) * xz, b[8] = Float(kShC2[4]) * (xx - yy);
    if (degree < 3) return;
    b[9] = Float(kShC3[0]) * y * (three * xx - yy), b[10] = Float(kShC3[1]) * xy * z;
    b[11] = Float(kShC3[2]) * y * (four * zz - xx - yy),
    b[12] = Float(kShC3[3]) * z * (two * zz - three * (xx + yy));
    b[13] = Float(kShC3[4]) * x * (four * zz - xx - yy), b[14] = Float(kShC3[5]) * z * (xx - yy);
    b[15] = Float(kShC3[6]) * x * (xx - three * yy);
}

// Its backward: ∂L/∂(x, y, z) from d = ∂L/∂Y_lm. The forward pass too needs it, for the colour's Jacobian.
SPLAT_INLINE void sh_basis_backward(const Float& x, const Float& y, const Float& z, int degree,
                                    const Float (&d)[16], Float (&g)[3]) {
    for (auto& v : g) v = 0.f;
    if (degree < 1) return;
    g[0] = Float(-kShC1) * d[3], g[1] = Float(-kShC1) * d[1], g[2] = Float(kShC1) * d[2];
    if (degree < 2) return;
    const Float two(2.f), three(3.f), four(4.f), six(6.f), eight(8.f);
    const Float a0(kShC2[0]), a1(kShC2[1]), a2(kShC2[2]), a3(kShC2[3]), a4(kShC2[4]);
    g[0] += a0 * y * d[4] - two * a2 * x * d[6] + a3 * z * d[7] + two * a4 * x * d[8];
    g[1] += a0 * x * d[4] + a1 * z * d[5] - two * a2 * y * d[6] - two * a4 * y * d[8];
    g[2] += a1 * y * d[5] + four * a2 * z * d[6] + a3 * x * d[7];
    if (degree < 3) return;
    const Float c0(kShC3[0]), c1(kShC3[1]), c2(kShC3[2]), c3(kShC3[3]), c4(kShC3[4]), c5(kShC3[5]),
        c6(kShC3[6]);
    Float xx = x * x, yy = y * y, zz = z * z, xy = x * y, yz = y * z, xz = x * z;
    g[0] += six * c0 * xy * d[9] + c1 * yz * d[10] - two * c2 * xy * d[11] - six * c3 * xz * d[12] +
            c4 * (four * zz - three * xx - yy) * d[13] + two * c5 * xz * d[14] +
            three * c6 * (xx - yy) * d[15];
    g[1] += three * c0 * (xx - yy) * d[9] + c1 * xz * d[10] + c2 * (four * zz - xx - three * yy) * d[11] -
            six * c3 * yz * d[12] - two * c4 * xy * d[13] - two * c5 * yz * d[14] - six * c6 * xy * d[15];
    g[2] += c1 * xy * d[10] + eight * c2 * yz * d[11] + three * c3 * (two * zz - xx - yy) * d[12] +
            eight * c4 * xz * d[13] + c5 * (xx - yy) * d[14];
}

inline constexpr int kRowVectors = 3;  // Floats for each Fourier order: 16 coefficients × 3 channels

// The coefficients of one Fourier order. Those beyond `coefficients` are zero when loaded.
struct ShRow {
    Float v[kRowVectors];

    SPLAT_INLINE static ShRow zero() {
        ShRow r;
        for (auto& x : r.v) x = 0.f;
        return r;
    }
    template <class Stored>
    SPLAT_INLINE static ShRow load(const Stored* row, int coefficients) {
        ShRow r;
        if (coefficients == 16) [[likely]] {
            for (int i = 0; i < kRowVectors; ++i) r.v[i] = load_as_float(row + kLanes * i);
        } else {
            for (int i = 0; i < kRowVectors; ++i) {
                const int left = 3 * coefficients - kLanes * i;
                r.v[i] = load_first_as_float(row + kLanes * i, left < 0 ? 0 : left > kLanes ? kLanes : left);
            }
        }
        return r;
    }
    SPLAT_INLINE ShRow& operator+=(const ShRow& other) {
        for (int i = 0; i < kRowVectors; ++i) v[i] += other.v[i];
        return *this;
    }
    SPLAT_INLINE friend ShRow operator*(ShRow a, const Float& b) {
        for (auto& x : a.v) x *= b;
        return a;
    }
    SPLAT_INLINE void store(scalar* row, int coefficients) const {
        for (int i = 0; i < kRowVectors; ++i) {
            const int left = 3 * coefficients - kLanes * i;
            if (left >= kLanes)
                v[i].store(row + kLanes * i);
            else if (left > 0)
                v[i].store_first(row + kLanes * i, left);
        }
    }
};

// The coefficient and the channel that lane l of a row's Float v holds.
inline constexpr struct RowLanes {
    alignas(64) int32_t coefficient[kRowVectors][kLanes], channel[kRowVectors][kLanes];
    constexpr RowLanes() : coefficient{}, channel{} {
        for (int v = 0; v < kRowVectors; ++v)
            for (int l = 0; l < kLanes; ++l)
                coefficient[v][l] = (kLanes * v + l) / 3, channel[v][l] = (kLanes * v + l) % 3;
    }
} kRowLanes;

}  // namespace splat
