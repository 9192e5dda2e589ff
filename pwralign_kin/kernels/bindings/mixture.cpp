// Bindings of the fit to noisy scans.
#include "../surface_mixture.hpp"
#include "arrays.hpp"
#include "bindings.hpp"

namespace pwr {

void bind_mixture(nb::module_ &m) {
    nb::class_<SurfaceMixture> type(m, "SurfaceMixture");
    type.def("__init__", [](SurfaceMixture *self, const Articulated &model, float spacing) {
        require(spacing > 0, "patches need a spacing");
        new (self) SurfaceMixture(model, spacing);
    }, "model"_a, "spacing"_a, nb::keep_alive<1, 2>());
    type.def("look", [](SurfaceMixture &self, Placements placements, Points directions, float unseen) {
        const std::vector<Rigid> T = part_placements(self.model, placements);
        nb::gil_scoped_release release;
        self.look(T, copied(directions), unseen);
    }, "placements"_a, "directions"_a, "unseen"_a);
    type.def("evidence",
             [](const SurfaceMixture &self, Points points, Placements placements,
                In<double, nb::shape<-1, 6, -1>> jacobians, float sigma, float strays, float volume, int threads) {
        const size_t parts = self.model.parts, n = jacobians.shape(2);
        require(jacobians.shape(0) == parts && sigma > 0 && volume > 0,
                "one Jacobian per part, a noise and a volume are needed");
        const std::vector<Rigid> T = part_placements(self.model, placements);
        auto out = unlocked(
            [&] { return self.evidence(copied(points), T, jacobians.data(), int(n), sigma, strays, volume, threads); });
        return nb::make_tuple(out.log_likelihood, to_numpy(std::move(out.g)),
                              to_numpy(std::move(out.H), {n + 1, n + 1}),
                              to_numpy(std::move(out.part_H), {parts, 6, 6}), out.strays);
    },
             "points"_a, "placements"_a, "jacobians"_a, "sigma"_a, "strays"_a, "volume"_a, "threads"_a);
}

} // namespace pwr
