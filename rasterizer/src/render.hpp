// Renders one view and takes its gradient: start reading here. Each stage is a file.
//
//     render           forward/preprocess.hpp            per Gaussian: cull in time, slice, project, colour
//                      forward/sort.hpp                  visible splats front to back
//                      forward/tile_intersection.hpp     per tile: which splats touch it, and where
//                      forward/blend.hpp                 per pixel: alpha blending
//     render_backward  backward/blend_backward.hpp       per pixel: gradients of the splats
//                      backward/preprocess_backward.hpp  per Gaussian: gradients of the parameters
//
// Inside preprocess, in order:
//
//     forward/slice_in_time.hpp  4D Gaussian → 3D Gaussian at time t      backward/slice_in_time_backward.hpp
//     forward/project_ewa.hpp    3D Gaussian → 2D Gaussian on the screen  backward/project_ewa_backward.hpp
//     forward/project.hpp        both, in float32 or in double            backward/project_backward.hpp
//     forward/sh.hpp             colour from SH and Fourier coefficients  backward/sh_backward.hpp
//
// view_state.hpp is what the stages keep for each other. training/ has the loss and the optimiser.
#pragma once

#include <stdexcept>
#include <utility>

#include "backward/blend_backward.hpp"
#include "backward/preprocess_backward.hpp"
#include "forward/preprocess.hpp"
#include "forward/sort.hpp"
#include "forward/tile_intersection.hpp"

namespace splat {

// Calls run.operator()<motion, order>(): each kind of model has compiled code of its own.
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

// Calls run.operator()<extra>() with extra, the number of channels beyond colour, as a constant.
template <class Run>
inline void with_extra(int extra, Run&& run) {
    auto at = [&]<int... k>(std::integer_sequence<int, k...>) {
        ((extra == k ? run.template operator()<k>() : void()), ...);
    };
    at(std::make_integer_sequence<int, kMaxExtraChannels + 1>{});
}

// Forward pass: writes the images of `out` and leaves in `view` what the backward pass needs.
inline void render(ViewState& view, Motion motion, const Parameters& p, const OutputPlanes& out) {
    with_model(motion, view.settings.fourier_order, [&]<Motion m, int order>() {
        view.settings.differentiable ? preprocess<m, order, true>(view, p)
                                     : preprocess<m, order, false>(view, p);
    });
    sort_by_depth(view);
    intersect_tiles(view);
    with_extra(view.settings.extra_channels(), [&]<int extra>() { blend<extra>(view, out); });
}

// Backward pass of the last `render`: `rendered` are its images, `d` their gradients. Adds to `out`.
inline void render_backward(ViewState& view, Motion motion, const Parameters& p, const InputPlanes& rendered,
                            const InputPlanes& d, const ParameterGradients& out,
                            const ViewGradient& view_out) {
    with_extra(view.settings.extra_channels(),
               [&]<int extra>() { blend_backward<extra>(view, rendered, d); });
    with_model(motion, view.settings.fourier_order,
               [&]<Motion m, int order>() { preprocess_backward<m, order>(view, p, out, view_out); });
}

}  // namespace splat
