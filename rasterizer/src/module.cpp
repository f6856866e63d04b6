// The kernel's Python bindings. Start reading in render.hpp.
//
// Arguments are checked in Python (validation.py), with their error messages. Arrays that are written are
// views of the caller's memory: .noconvert() refuses others, of which nanobind would pass a copy. Arrays that
// are only read may be copied.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <array>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "benchmark/machine_throughput.hpp"
#include "benchmark/pixel_gaussian_pairs.hpp"
#include "render.hpp"
#include "training/adam.hpp"
#include "training/array_passes.hpp"
#include "training/densification_statistics.hpp"
#include "training/loss.hpp"

#define SPLAT_TEXT_OF(x) #x
#define SPLAT_TEXT(x) SPLAT_TEXT_OF(x)  // of the expansion of x

namespace nb = nanobind;

// Names of the 16-bit types of SH coefficients in Python.
template <>
struct nanobind::detail::dtype_traits<splat::Float16> {
    static constexpr nb::dlpack::dtype value{static_cast<uint8_t>(nb::dlpack::dtype_code::Float), 16, 1};
    static constexpr auto name = nb::detail::const_name("float16");
};
template <>
struct nanobind::detail::dtype_traits<splat::Bfloat16> {
    static constexpr nb::dlpack::dtype value{static_cast<uint8_t>(nb::dlpack::dtype_code::Bfloat), 16, 1};
    static constexpr auto name = nb::detail::const_name("bfloat16");
};

namespace {

using splat::scalar;

template <class T>
using Array = nb::ndarray<T, nb::c_contig, nb::device::cpu>;
using In = Array<const scalar>;
using Out = Array<scalar>;

// An argument that is written.
auto written(const char* name) { return nb::arg(name).noconvert(); }

template <class T>
T* pointer(const std::optional<Array<T>>& a) {
    return a ? a->data() : nullptr;
}

// The stored parameters; keeps its arrays alive.
struct Gaussians {
    In mean, log_scale, quat_left;
    std::optional<In> quat_right, velocity, weights, trajectories;
    In opacity_logit;
    Array<const splat::ShStored> sh;
    int coefficients, stored_order;

    splat::Motion motion() const {
        if (mean.shape(1) == 3) return splat::Motion::kStatic;
        return quat_right ? splat::Motion::kFull : splat::Motion::kSeparable;
    }
    splat::Parameters parameters() const {
        return {static_cast<uint32_t>(mean.shape(0)),
                mean.data(),
                log_scale.data(),
                quat_left.data(),
                pointer(quat_right),
                pointer(velocity),
                opacity_logit.data(),
                sh.data(),
                coefficients,
                stored_order,
                pointer(weights),
                pointer(trajectories),
                trajectories ? static_cast<int>(trajectories->shape(0)) : 0};
    }
};

using CameraDouble = splat::CameraOf<double>;

// position: the camera's centre. The time comes with set_view.
CameraDouble camera_from(int width, int height, const std::vector<double>& intrinsics,
                         Array<const double> world_to_cam, const std::vector<double>& position) {
    CameraDouble c{
        width, height, intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3], {}, {}, {}, 0.0, 0.0,
        0.0,   {}};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) c.rotation[i][j] = world_to_cam.data()[4 * i + j];
        c.position[i] = position[i];
    }
    return c;
}

// The camera of the flow's later time, as the kernel reads it.
splat::FlowCamera<double> flow_camera_of(const CameraDouble& now, const CameraDouble& later, bool moved) {
    splat::FlowCamera<double> r{
        {}, {}, {later.fx - now.fx, later.fy - now.fy}, {later.cx - now.cx, later.cy - now.cy}, moved};
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) r.rotation[i][j] = later.rotation[i][j];
        r.shift[i] = now.position[i] - later.position[i];
    }
    return r;
}

// Colour, alpha, depth, flow and statistics; none for those not rendered.
using Images = std::array<std::optional<Out>, 5>;

// The state of one view, with the rendered images, which the backward pass reads.
class Rasterizer {
public:
    void set_view(const CameraDouble& camera, double time, double marginal_offset, double duration,
                  scalar near_plane, const std::vector<scalar>& background, scalar flow_dt,
                  std::optional<CameraDouble> flow_camera, int sh_degree, int fourier_order,
                  std::tuple<bool, bool, bool> extras, bool differentiable, bool detached, int threads) {
        state_.camera_double = camera;
        state_.camera_double.time = time;
        state_.camera_double.marginal_offset = marginal_offset;
        state_.camera_double.flow_camera =
            flow_camera_of(camera, flow_camera.value_or(camera), flow_camera.has_value());
        state_.camera = splat::rounded(state_.camera_double);
        state_.settings = {duration,
                           near_plane,
                           {background[0], background[1], background[2]},
                           flow_dt,
                           sh_degree,
                           fourier_order,
                           std::get<0>(extras),
                           std::get<1>(extras),
                           std::get<2>(extras),
                           differentiable,
                           detached,
                           threads};
    }
    // For the forward pass, whose images these are.
    splat::View view(const Gaussians& gaussians, const Images& images) {
        rendered_ = images;
        return {state_,
                gaussians.parameters(),
                {pointer(images[0]), pointer(images[1]), pointer(images[2]), pointer(images[3]),
                 pointer(images[4])}};
    }
    void backward(const Gaussians& gaussians, std::optional<In> color, std::optional<In> alpha,
                  std::optional<In> depth, std::optional<In> flow, std::optional<In> stats, Out mean,
                  Out log_scale, Out quat_left, std::optional<Out> quat_right, std::optional<Out> velocity,
                  std::optional<Out> weights, std::optional<Out> trajectories, Out opacity_logit,
                  Array<int32_t> visible, Out mean2d, Out mean_t, Out radius, Out color_gradient) {
        const splat::InputPlanes d{pointer(color), pointer(alpha), pointer(depth), pointer(flow),
                                   pointer(stats)};
        const splat::InputPlanes rendered{pointer(rendered_[0]), pointer(rendered_[1]), pointer(rendered_[2]),
                                          pointer(rendered_[3]), pointer(rendered_[4])};
        const splat::ParameterGradients out{mean.data(),         log_scale.data(),     quat_left.data(),
                                            pointer(quat_right), pointer(velocity),    opacity_logit.data(),
                                            pointer(weights),    pointer(trajectories)};
        const splat::ViewGradient view{visible.data(), mean2d.data(), mean_t.data(), radius.data(),
                                       reinterpret_cast<splat::ColorGradient*>(color_gradient.data())};
        nb::gil_scoped_release release;
        splat::render_backward(state_, gaussians.motion(), gaussians.parameters(), rendered, d, out, view);
    }
    uint32_t visible() const { return state_.visible; }
    uint32_t alive() const { return state_.alive; }
    size_t intersections() const { return state_.gradient_index.size(); }
    std::tuple<uint64_t, uint64_t> count_pairs() const {
        const splat::PixelGaussianPairs pairs = splat::count_pairs(state_);
        return {pairs.evaluated, pairs.contributing};
    }
    std::vector<double> stage_ms() const { return {state_.stage_ms, state_.stage_ms + 6}; }

private:
    splat::ViewState state_;
    Images rendered_;
};

void render(const std::vector<Rasterizer*>& rasterizers, const std::vector<Gaussians>& gaussians,
            const std::vector<Images>& images) {
    std::vector<splat::View> views;
    for (size_t v = 0; v < rasterizers.size(); ++v)
        views.push_back(rasterizers[v]->view(gaussians[v], images[v]));
    nb::gil_scoped_release release;
    splat::render(views, gaussians.front().motion());
}

// visible [V], color gradient [V, 8], sh_degree, fourier_order, wrong_line
using View = std::tuple<Array<const int32_t>, In, int, int, bool>;

std::vector<splat::ViewColors> view_colors(const std::vector<View>& views) {
    std::vector<splat::ViewColors> out;
    for (const auto& [visible, gradient, degree, order, wrong_line] : views)
        out.push_back({static_cast<uint32_t>(visible.shape(0)), visible.data(),
                       reinterpret_cast<const splat::ColorGradient*>(gradient.data()), degree, order,
                       wrong_line});
    return out;
}

void expand_sh(const std::vector<View>& views, Out dense, int coefficients, int orders, int threads) {
    const auto colors = view_colors(views);
    nb::gil_scoped_release release;
    splat::dense_sh_gradient(colors, static_cast<uint32_t>(dense.shape(0)), coefficients, orders,
                             dense.data(), threads);
}

void adam_step(Out param, In grad, Out m, Out v, const std::vector<scalar>& lr,
               std::optional<Array<const uint8_t>> sparse_rows, double beta1, double beta2, double epsilon,
               long step, int threads) {
    const size_t rows = param.shape(0);
    nb::gil_scoped_release release;
    splat::adam_rows(param.data(), grad.data(), m.data(), v.data(), rows, static_cast<int>(lr.size()),
                     lr.data(), pointer(sparse_rows), splat::AdamStep(beta1, beta2, epsilon, step), threads);
}

void sh_adam_step(Out sh, Out m, Out v, int coefficients, int orders, int active_coefficients,
                  int active_orders, const std::array<scalar, 4>& lr,
                  std::optional<Array<const uint8_t>> sparse_rows, const std::vector<View>& views,
                  double beta1, double beta2, double epsilon, long step, int threads) {
    const auto colors = view_colors(views);
    const uint32_t count = static_cast<uint32_t>(sh.shape(0));
    nb::gil_scoped_release release;
    splat::adam_sh(sh.data(), m.data(), v.data(), count, coefficients, orders, active_coefficients,
                   active_orders, {lr[0], lr[1], lr[2], lr[3]}, pointer(sparse_rows), colors,
                   splat::AdamStep(beta1, beta2, epsilon, step), threads);
}

void set_to_zero(const std::vector<Out>& arrays, int threads) {
    nb::gil_scoped_release release;
    for (const Out& a : arrays) splat::set_to_zero(a.data(), static_cast<int64_t>(a.size()), threads);
}

bool all_finite(In array, int threads) {
    nb::gil_scoped_release release;
    return splat::all_finite(array.data(), static_cast<int64_t>(array.size()), threads);
}

void accumulate(Array<const int32_t> visible, In mean2d, In mean_t, scalar half_width, scalar half_height,
                scalar duration, Out space, Out time, Out views, int threads) {
    const splat::DensificationStatistics to{space.data(), time.data(), views.data()};
    nb::gil_scoped_release release;
    splat::accumulate(visible.data(), mean2d.data(), mean_t.data(), static_cast<int64_t>(visible.size()),
                      half_width, half_height, duration, to, threads);
}

void mark_visible(Array<const int32_t> visible, Array<uint8_t> mask, int threads) {
    nb::gil_scoped_release release;
    splat::mark_visible(visible.data(), static_cast<int64_t>(visible.size()), mask.data(), threads);
}

std::tuple<double, double, double> photometric_loss(In image, In target, Out gradient, scalar ssim_weight,
                                                    scalar mse_weight, scalar share, int threads,
                                                    bool copy_background) {
    const int height = static_cast<int>(image.shape(1)), width = static_cast<int>(image.shape(2));
    nb::gil_scoped_release release;
    const auto value = splat::photometric_loss(image.data(), target.data(), width, height, ssim_weight,
                                               mse_weight, share, gradient.data(), copy_background, threads);
    return {value.l1, value.ssim, value.mse};
}

}  // namespace

NB_MODULE(KERNEL_MODULE_NAME, m) {
    // Autograd graphs that exist when the interpreter ends hold rasterizers; that is no leak.
    nb::set_leak_warnings(false);
    nb::class_<Gaussians>(m, "Gaussians")
        .def(nb::init<In, In, In, std::optional<In>, std::optional<In>, std::optional<In>, std::optional<In>,
                      In, Array<const splat::ShStored>, int, int>(),
             nb::arg("mean"), nb::arg("log_scale"), nb::arg("quat_left"), nb::arg("quat_right").none(),
             nb::arg("velocity").none(), nb::arg("weights").none(), nb::arg("trajectories").none(),
             nb::arg("opacity_logit"), nb::arg("sh"), nb::arg("coefficients"), nb::arg("stored_order"));
    nb::class_<CameraDouble>(m, "Camera").def_static("make", &camera_from);
    nb::class_<Rasterizer>(m, "Rasterizer")
        .def(nb::init<>())
        .def("set_view", &Rasterizer::set_view, nb::arg("camera"), nb::arg("time"),
             nb::arg("marginal_offset"), nb::arg("duration"), nb::arg("near"), nb::arg("background"),
             nb::arg("flow_dt"), nb::arg("flow_camera").none(), nb::arg("sh_degree"),
             nb::arg("fourier_order"), nb::arg("extras"), nb::arg("differentiable"), nb::arg("detached"),
             nb::arg("threads"))
        .def("backward", &Rasterizer::backward, nb::arg("gaussians"), nb::arg("d_color").none(),
             nb::arg("d_alpha").none(), nb::arg("d_depth").none(), nb::arg("d_flow").none(),
             nb::arg("d_stats").none(), written("mean"), written("log_scale"), written("quat_left"),
             written("quat_right").none(), written("velocity").none(), written("weights").none(),
             written("trajectories").none(), written("opacity_logit"), written("visible"), written("mean2d"),
             written("mean_t"), written("radius"), written("color_gradient"))
        .def_prop_ro("visible", &Rasterizer::visible)
        .def_prop_ro("alive", &Rasterizer::alive)
        .def_prop_ro("intersections", &Rasterizer::intersections)
        .def("count_pairs", &Rasterizer::count_pairs)
        .def_prop_ro("stage_ms", &Rasterizer::stage_ms);
    m.def("render", &render, nb::arg("rasterizers"), nb::arg("gaussians"), written("images"));
    m.def("expand_sh", &expand_sh, nb::arg("views"), written("dense"), nb::arg("coefficients"),
          nb::arg("orders"), nb::arg("threads"));
    m.def("adam_step", &adam_step, written("param"), nb::arg("grad"), written("m"), written("v"),
          nb::arg("lr"), nb::arg("sparse_rows").none(), nb::arg("beta1"), nb::arg("beta2"),
          nb::arg("epsilon"), nb::arg("step"), nb::arg("threads"));
    m.def("sh_adam_step", &sh_adam_step, written("sh"), written("m"), written("v"), nb::arg("coefficients"),
          nb::arg("orders"), nb::arg("active_coefficients"), nb::arg("active_orders"), nb::arg("lr"),
          nb::arg("sparse_rows").none(), nb::arg("views"), nb::arg("beta1"), nb::arg("beta2"),
          nb::arg("epsilon"), nb::arg("step"), nb::arg("threads"));
    m.def("accumulate", &accumulate, nb::arg("visible"), nb::arg("mean2d"), nb::arg("mean_t"),
          nb::arg("half_width"), nb::arg("half_height"), nb::arg("duration"), written("space"),
          written("time"), written("views"), nb::arg("threads"));
    m.def("mark_visible", &mark_visible, nb::arg("visible"), written("mask"), nb::arg("threads"));
    m.def("set_to_zero", &set_to_zero, written("arrays"), nb::arg("threads"));
    m.def("all_finite", &all_finite, nb::arg("array"), nb::arg("threads"));
    nb::dict choices;  // what this kernel was built with (numerical_choices.hpp)
    choices["min_marginal"] = splat::kMinMarginal;
    choices["min_alpha"] = splat::kMinAlpha;
    choices["min_transmittance"] = RASTERIZER_MIN_TRANSMITTANCE;
    choices["exp_degree"] = splat::kAlphaExpDegree;
    choices["exact_culling"] = splat::kExactCulling;
    choices["block_masks"] = splat::kBlockMasks;
    choices["float64"] = static_cast<bool>(RASTERIZER_FLOAT64);
    choices["sh_type"] = SPLAT_TEXT(RASTERIZER_SH_TYPE);
    m.attr("choices") = choices;
    m.def("measure_throughput", [] {
        const splat::MachineThroughput rates = splat::measure_throughput();
        return std::tuple{rates.fma_per_second, rates.copy_bytes_per_second};
    });
    m.def("photometric_loss", &photometric_loss, nb::arg("image"), nb::arg("target"), written("gradient"),
          nb::arg("ssim_weight"), nb::arg("mse_weight"), nb::arg("share"), nb::arg("threads"),
          nb::arg("copy_background") = true);  // false, for tests: every block is computed
}
