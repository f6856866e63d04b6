// Backward of forward/quaternion.hpp: ∂L/∂q from ∂L/∂R.
#pragma once

#include "forward/quaternion.hpp"

namespace splat {

// ∂L/∂q from ∂L/∂(q/|q|): the component along q vanishes.
template <class Real>
SPLAT_INLINE void normalise_backward(const UnitQuaternion<Real>& u, const Real (&d_unit)[4], Real (&d_q)[4]) {
    Real radial(0.f);
    for (int i = 0; i < 4; ++i) radial += d_unit[i] * u.q[i];
    for (int i = 0; i < 4; ++i) d_q[i] = (d_unit[i] - radial * u.q[i]) * u.inverse_norm;
}

template <class Real>
SPLAT_INLINE void rotation_4d_backward(const UnitQuaternion<Real>& left, const UnitQuaternion<Real>& right,
                                       const Real (&dR)[4][4], Real (&d_left)[4], Real (&d_right)[4]) {
    for (int i = 0; i < 4; ++i) d_left[i] = d_right[i] = 0.f;
#pragma GCC unroll 4
    for (int i = 0; i < 4; ++i)
#pragma GCC unroll 4
        for (int j = 0; j < 4; ++j) {
            Real dL = dR[i][0] * right_matrix(right, j, 0), dQ = left_matrix(left, 0, i) * dR[0][j];
#pragma GCC unroll 4
            for (int k = 1; k < 4; ++k) {
                dL += dR[i][k] * right_matrix(right, j, k);
                dQ += left_matrix(left, k, i) * dR[k][j];
            }
            d_left[kQuatIndex[i][j]] += dL * Real(kLeftSign[i][j]);
            d_right[kQuatIndex[i][j]] += dQ * Real(kRightSign[i][j]);
        }
}

template <class Real>
SPLAT_INLINE void rotation_3d_backward(const UnitQuaternion<Real>& u, const Real (&d)[3][3], Real (&dq)[4]) {
    const Real &w = u.q[0], &x = u.q[1], &y = u.q[2], &z = u.q[3];
    const Real two(2.f);
    dq[0] = two * (x * (d[2][1] - d[1][2]) + y * (d[0][2] - d[2][0]) + z * (d[1][0] - d[0][1]));
    dq[1] = two * (y * (d[0][1] + d[1][0]) + z * (d[0][2] + d[2][0]) + w * (d[2][1] - d[1][2]) -
                   two * x * (d[1][1] + d[2][2]));
    dq[2] = two * (x * (d[0][1] + d[1][0]) + z * (d[1][2] + d[2][1]) + w * (d[0][2] - d[2][0]) -
                   two * y * (d[0][0] + d[2][2]));
    dq[3] = two * (x * (d[0][2] + d[2][0]) + y * (d[1][2] + d[2][1]) + w * (d[1][0] - d[0][1]) -
                   two * z * (d[0][0] + d[1][1]));
}

}  // namespace splat
