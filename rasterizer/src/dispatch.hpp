// From what a frame asks for to the code compiled for exactly that.
#pragma once

#include <stdexcept>
#include <utility>

#include "bin.hpp"
#include "blend_backward.hpp"
#include "gaussian_backward.hpp"
#include "prepare.hpp"
#include "sort.hpp"

namespace splat {

// Calls run.operator()<motion, order>().
template <class Run>
inline void with_model(Motion motion, int order, Run&& run) {
    auto with_order = [&]<Motion m>() {
        switch (order) {
            case 0:
                return run.template operator()<m, 0>();
            case 1:
                return run.template operator()<m, 1>();
            case 2:
                return run.template operator()<m, 2>();
        }
        throw std::invalid_argument("fourier_order must be 0, 1 or 2");
    };
    switch (motion) {
        case Motion::kStatic:
            return run.template operator()<Motion::kStatic, 0>();
        case Motion::kSeparable:
            return with_order.template operator()<Motion::kSeparable>();
        case Motion::kFull:
            return with_order.template operator()<Motion::kFull>();
    }
}

// Calls run.operator()<extra>() with extra = 0 .. kMaxExtra.
template <class Run>
inline void with_extra(int extra, Run&& run) {
    auto at = [&]<int... k>(std::integer_sequence<int, k...>) {
        ((extra == k ? run.template operator()<k>() : void()), ...);
    };
    at(std::make_integer_sequence<int, kMaxExtra + 1>{});
}

inline void render(Frame& f, Motion motion, const Parameters& p, const OutputPlanes& out) {
    with_model(motion, f.settings.fourier_order, [&]<Motion m, int order>() {
        f.settings.differentiable ? prepare<m, order, true>(f, p) : prepare<m, order, false>(f, p);
    });
    sort_by_depth(f);
    bin(f);
    with_extra(f.settings.extra_channels(), [&]<int extra>() { blend<extra>(f, out); });
}

inline void render_backward(Frame& f, Motion motion, const Parameters& p, const InputPlanes& rendered,
                            const InputPlanes& d, const ParameterGradients& out,
                            const ViewGradient& view_out) {
    with_extra(f.settings.extra_channels(), [&]<int extra>() { blend_backward<extra>(f, rendered, d); });
    with_model(motion, f.settings.fourier_order,
               [&]<Motion m, int order>() { gaussian_backward<m, order>(f, p, out, view_out); });
}

}  // namespace splat
