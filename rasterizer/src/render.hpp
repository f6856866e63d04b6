// Renders the views of a batch and takes their gradients: start reading here. Each stage is a file.
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
#include <vector>

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

// A view of a batch: its state, the Gaussians as it shows them, and its images.
struct View {
    ViewState& state;
    Parameters gaussians;
    OutputPlanes out;
};

// A chunk of Gaussians goes through all views while its parameters are in cache.
inline void preprocess(const std::vector<View>& views, Motion motion) {
    StageTimer timer(views.front().state, kStagePreprocess);
    const uint32_t count = views.front().gaussians.count;
    for (const View& view : views) {
        view.state.stage_ms[kStagePreprocess] = 0;  // the first view's has the time of all
        make_room(view.state, count);
    }
    const int chunks = chunks_of(count);
#pragma omp parallel num_threads(views.front().state.settings.threads)
    {
        ChunkScratch scratch;
#pragma omp for schedule(dynamic, 1)
        for (int c = 0; c < chunks; ++c)
            for (const View& view : views)
                with_model(motion, view.state.settings.fourier_order, [&]<Motion m, int order>() {
                    view.state.settings.differentiable
                        ? preprocess_chunk<m, order, true>(view.state, view.gaussians, c, scratch)
                        : preprocess_chunk<m, order, false>(view.state, view.gaussians, c, scratch);
                });
        end_of_streaming();
    }
    for (const View& view : views) count_visible(view.state);
}

// Forward pass of views of the same number of Gaussians and one motion: writes the images of each and leaves
// in its state what the backward pass needs.
inline void render(const std::vector<View>& views, Motion motion) {
    preprocess(views, motion);
    for (const View& view : views) {
        sort_by_depth(view.state);
        intersect_tiles(view.state);
        with_extra(view.state.settings.extra_channels(),
                   [&]<int extra>() { blend<extra>(view.state, view.out); });
    }
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
