// Rotation matrices from quaternions, in four dimensions and in three (paper, section 3.2).
#pragma once

#include "simd/real.hpp"
#include "simd/vec_move.hpp"
#include "types.hpp"

namespace splat {

// 1/|q| is at most this, so that the gradient of a denormal quaternion is finite.
inline constexpr scalar kLargestInverse = 1e30f;

template <class Real>
struct UnitQuaternion {
    Real q[4];
    Real inverse_norm;
};

// q/|q|; zero counts as the identity. Scaled by a power of two first where a square would over- or underflow.
template <class Real>
SPLAT_INLINE UnitQuaternion<Real> normalise(const Real (&q)[4]) {
    const Real largest = max(max(abs(q[0]), abs(q[1])), max(abs(q[2]), abs(q[3])));
    const MaskOf<Real> usable = largest > Real(0.f);
    const Real scale = select(largest < Real(0x1p-40f), Real(0x1p100f),
                              select(largest > Real(0x1p40f), Real(0x1p-100f), Real(1.f)));
    Real s[4], norm2(0.f);
    for (int i = 0; i < 4; ++i) {
        s[i] = q[i] * scale;
        norm2 += s[i] * s[i];
    }
    const Real inverse = zero_unless(usable, Real(1.f) / sqrt(norm2));
    UnitQuaternion<Real> u;
    for (int i = 0; i < 4; ++i) u.q[i] = s[i] * inverse;
    u.q[0] = select(usable, u.q[0], Real(1.f));
    u.inverse_norm = min(inverse * scale, Real(kLargestInverse));
    return u;
}

// L(q)[i][j] = kLeftSign[i][j] q[kQuatIndex[i][j]], R(q) likewise with kRightSign (docs/method.md 1).
inline constexpr int kQuatIndex[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}};
inline constexpr scalar kLeftSign[4][4] = {{1, -1, -1, -1}, {1, 1, -1, 1}, {1, 1, 1, -1}, {1, -1, 1, 1}};
inline constexpr scalar kRightSign[4][4] = {{1, -1, -1, -1}, {1, 1, 1, -1}, {1, -1, 1, 1}, {1, 1, -1, 1}};

template <class Real>
SPLAT_INLINE Real left_matrix(const UnitQuaternion<Real>& u, int i, int j) {
    return u.q[kQuatIndex[i][j]] * Real(kLeftSign[i][j]);
}
template <class Real>
SPLAT_INLINE Real right_matrix(const UnitQuaternion<Real>& u, int i, int j) {
    return u.q[kQuatIndex[i][j]] * Real(kRightSign[i][j]);
}

// The 4D rotation L(ql) R(qr).
template <class Real>
SPLAT_INLINE void rotation_4d(const UnitQuaternion<Real>& left, const UnitQuaternion<Real>& right,
                              Real (&R)[4][4]) {
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i)
#pragma GCC unroll 4
        for (int j = 0; j < 4; ++j) {
            R[i][j] = left_matrix(left, i, 0) * right_matrix(right, 0, j);
#pragma GCC unroll 4
            for (int k = 1; k < 4; ++k) R[i][j] += left_matrix(left, i, k) * right_matrix(right, k, j);
        }
}

// The 3D rotation of the unit quaternion (w, x, y, z).
template <class Real>
SPLAT_INLINE void rotation_3d(const UnitQuaternion<Real>& u, Real (&R)[3][3]) {
    const Real &w = u.q[0], &x = u.q[1], &y = u.q[2], &z = u.q[3];
    const Real one(1.f), two(2.f);
    R[0][0] = one - two * (y * y + z * z), R[0][1] = two * (x * y - w * z), R[0][2] = two * (x * z + w * y);
    R[1][0] = two * (x * y + w * z), R[1][1] = one - two * (x * x + z * z), R[1][2] = two * (y * z - w * x);
    R[2][0] = two * (x * z - w * y), R[2][1] = two * (y * z + w * x), R[2][2] = one - two * (x * x + y * y);
}

}  // namespace splat
