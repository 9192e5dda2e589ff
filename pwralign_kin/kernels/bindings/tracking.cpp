// Bindings of the tracker.
#include "../tracking.hpp"
#include "arrays.hpp"
#include "bindings.hpp"

namespace pwr {

namespace {

PinholeView read_view(const Matrix &K, double scale, const Placements &camera, size_t height, size_t width) {
    require(K.shape(0) == 3 && K.shape(1) == 3 && camera.shape(0) == 1 && height > 0 && width > 0,
            "a depth image needs a 3x3 camera matrix and one placement");
    const double *k = K.data();
    return {k[0], k[4], k[2], k[5], k[1], scale, read_placement(camera.data()), int(height), int(width)};
}

void require_configuration(const Tracking &self, const Placements &base, const Doubles &values) {
    require(base.shape(0) == 1 && int(values.size()) == self.model.joints,
            "one base and one value per joint are needed");
}

} // namespace

void bind_tracking(nb::module_ &m) {
    m.def("explained_within", &explained_within, "noise"_a);
    nb::class_<TrackingJudgement>(m, "TrackingJudgement")
        .def_ro("noise", &TrackingJudgement::noise)
        .def_ro("tolerance", &TrackingJudgement::tolerance)
        .def_ro("coverage", &TrackingJudgement::coverage)
        .def_ro("agreement", &TrackingJudgement::agreement)
        .def_ro("visible", &TrackingJudgement::visible)
        .def_ro("supported", &TrackingJudgement::supported)
        .def_ro("cost", &TrackingJudgement::cost);
    nb::class_<Tracking> type(m, "Tracking");
    type.def("__init__", [](Tracking *self, const Articulated &model, int points, float cell) {
        require(points > 0 && cell > 0, "a tracker needs points and cells");
        new (self) Tracking(model, points, cell);
    }, "model"_a, "points"_a, "cell"_a, nb::keep_alive<1, 2>());
    type.def(
        "expect",
        [](Tracking &self, Placements base, Doubles values, Doubles centre, double unit, Doubles sensor, float margin) {
        require_configuration(self, base, values);
        require(centre.size() == 3 && (sensor.size() == 0 || sensor.size() == 3) && unit > 0,
                "a centre and a sensor have three coordinates");
        self.expect(read_placement(base.data()), values.data(), centre.data(), unit,
                    sensor.size() ? sensor.data() : nullptr, margin);
    }, "base"_a, "values"_a, "centre"_a, "unit"_a, "sensor"_a, "margin"_a);
    type.def("look_at_points", [](Tracking &self, In<float, nb::shape<-1, 3>> points) {
        nb::gil_scoped_release release;
        self.look(points.data(), points.shape(0));
    }, "points"_a);
    type.def("look_at_points", [](Tracking &self, In<double, nb::shape<-1, 3>> points) {
        nb::gil_scoped_release release;
        self.look(points.data(), points.shape(0));
    }, "points"_a);
    type.def(
        "look_at_depth",
        [](Tracking &self, In<float, nb::shape<-1, -1>> depth, Matrix intrinsics, double scale, Placements camera) {
        const PinholeView view = read_view(intrinsics, scale, camera, depth.shape(0), depth.shape(1));
        nb::gil_scoped_release release;
        self.look(depth.data(), view);
    }, "depth"_a, "intrinsics"_a, "scale"_a, "camera"_a);
    type.def(
        "look_at_depth",
        [](Tracking &self, In<uint16_t, nb::shape<-1, -1>> depth, Matrix intrinsics, double scale, Placements camera) {
        const PinholeView view = read_view(intrinsics, scale, camera, depth.shape(0), depth.shape(1));
        nb::gil_scoped_release release;
        self.look(depth.data(), view);
    }, "depth"_a, "intrinsics"_a, "scale"_a, "camera"_a);
    type.def_prop_ro("points", [](const Tracking &self) { return int(self.kept.size()); });
    type.def("fit",
             [](Tracking &self, Placements base, Doubles values, Placements predicted, Doubles predicted_values,
                Matrix expected, Bytes held, float sigma_first, float sigma_last, float noise, int iterations,
                double seconds) {
        const size_t k = self.model.joints;
        require(base.shape(0) == 1 && predicted.shape(0) == 1 && values.size() == k && predicted_values.size() == k &&
                    held.size() == k && expected.shape(0) == 6 + k && expected.shape(1) == 6 + k,
                "one base, one value per joint and an inverse covariance of both are needed");
        Rigid T = read_placement(base.data());
        std::vector<double> fitted(values.data(), values.data() + k);
        auto result = unlocked([&] {
            return self.fit(T, fitted.data(), read_placement(predicted.data()), predicted_values.data(),
                            expected.data(), held.data(), sigma_first, sigma_last, noise, iterations, seconds);
        });
        std::vector<double> placed(16);
        write_placement(T, placed.data());
        return nb::make_tuple(to_numpy(std::move(placed), {4, 4}), to_numpy(std::move(fitted)), result.iterations,
                              result.rmse);
    },
             "base"_a, "values"_a, "predicted"_a, "predicted_values"_a, "expected"_a, "held"_a, "sigma_first"_a,
             "sigma_last"_a, "noise"_a, "iterations"_a, "seconds"_a);
    type.def_prop_ro("information", [](const Tracking &self) {
        const size_t size = 6 + self.model.joints;
        return to_numpy(std::vector<double>(self.information), {size, size});
    }, nb::rv_policy::move);
    type.def("judge", [](Tracking &self, Placements base, Doubles values, float tolerance) {
        require_configuration(self, base, values);
        return unlocked([&] { return self.judge(read_placement(base.data()), values.data(), tolerance); });
    }, "base"_a, "values"_a, "tolerance"_a);
    type.def_prop_ro("levers", [](const Tracking &self) { return to_numpy(std::vector<double>(self.levers)); },
                     nb::rv_policy::move);
    type.def_prop_ro("explained", [](const Tracking &self) { return to_numpy(std::vector<float>(self.explained)); },
                     nb::rv_policy::move);
    type.def_prop_ro("strays", [](const Tracking &self) { return to_numpy(std::vector<float>(self.strays)); },
                     nb::rv_policy::move);
    type.def_prop_ro("visible", [](const Tracking &self) { return to_numpy(std::vector<float>(self.visible)); },
                     nb::rv_policy::move);
    type.def_prop_ro("shown", [](const Tracking &self) { return to_numpy(std::vector<float>(self.shown)); },
                     nb::rv_policy::move);
    type.def("weigh", [](Tracking &self, Placements base, Matrix values, Bytes varied, float tolerance) {
        require(base.shape(0) == 1 && int(values.shape(1)) == self.model.joints &&
                    int(varied.size()) == self.model.joints && tolerance > 0,
                "one base, one value per joint in each row and a tolerance are needed");
        std::vector<float> against(values.shape(0));
        unlocked([&] {
            self.weigh(read_placement(base.data()), values.data(), int64_t(values.shape(0)), varied.data(), tolerance,
                       against.data());
        });
        return to_numpy(std::move(against));
    }, "base"_a, "values"_a, "varied"_a, "tolerance"_a);
    type.def("sweep", [](Tracking &self, Placements base, Doubles values, int variable, double range, float sigma) {
        require_configuration(self, base, values);
        require(variable >= 0 && variable < 6 + self.model.joints, "no such variable");
        std::vector<double> changes;
        std::vector<float> scores;
        unlocked(
            [&] { self.sweep(read_placement(base.data()), values.data(), variable, range, sigma, changes, scores); });
        return nb::make_tuple(to_numpy(std::move(changes)), to_numpy(std::move(scores)));
    }, "base"_a, "values"_a, "variable"_a, "range"_a, "sigma"_a);
}

} // namespace pwr
