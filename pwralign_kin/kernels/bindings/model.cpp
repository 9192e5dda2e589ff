// Bindings of a model: its kinematics, its surface and its triangles.
#include "../triangles.hpp"
#include "arrays.hpp"
#include "bindings.hpp"
#include "configurations.hpp"

namespace pwr {

void bind_model(nb::module_ &m) {
    nb::class_<Articulated> type(m, "Articulated");
    type.def("__init__",
             [](Articulated *self, Ints parent, Ints actuated, Placements placement, Matrix axis, Bytes prismatic,
                Doubles multiplier, Doubles offset, Doubles lower, Doubles upper, Bytes wraps) {
        const size_t n = parent.shape(0), k = lower.shape(0);
        require(n > 0 && actuated.shape(0) == n && placement.shape(0) == n && axis.shape(0) == n &&
                    axis.shape(1) == 3 && prismatic.shape(0) == n && multiplier.shape(0) == n && offset.shape(0) == n,
                "the arrays of the parts differ in length");
        require(upper.shape(0) == k && wraps.shape(0) == k, "the arrays of the joints differ in length");
        for (size_t i = 1; i < n; ++i)
            require(parent.data()[i] >= 0 && parent.data()[i] < int(i) && actuated.data()[i] >= 0 &&
                        actuated.data()[i] < int(k),
                    "parts must come after their parents and name an actuated joint");
        new (self) Articulated();
        self->parts = int(n), self->joints = int(k);
        self->parent.assign(parent.data(), parent.data() + n);
        self->actuated.assign(actuated.data(), actuated.data() + n);
        for (size_t i = 0; i < n; ++i) self->placement.push_back(read_placement(placement.data() + 16 * i));
        self->axis.assign(axis.data(), axis.data() + 3 * n);
        self->multiplier.assign(multiplier.data(), multiplier.data() + n);
        self->offset.assign(offset.data(), offset.data() + n);
        self->prismatic.assign(prismatic.data(), prismatic.data() + n);
        self->lower.assign(lower.data(), lower.data() + k);
        self->upper.assign(upper.data(), upper.data() + k);
        self->wraps.assign(wraps.data(), wraps.data() + k);
        self->surface.resize(n);
    },
             "parent"_a, "actuated"_a, "placement"_a, "axis"_a, "prismatic"_a, "multiplier"_a, "offset"_a, "lower"_a,
             "upper"_a, "wraps"_a);
    type.def("set_surface",
             [](Articulated &self, int part, Points samples, Points normals, Floats weights, Points dense,
                Points dense_normals, Points apparent_normals, In<uint16_t, nb::shape<-1, -1, -1>> grid,
                std::tuple<float, float, float> origin, float cell, float slack, std::tuple<float, float, float> centre,
                float radius, float size, float area, float weight) {
        require(part >= 0 && part < self.parts, "no such part");
        require(normals.shape(0) == samples.shape(0) && weights.shape(0) == samples.shape(0) &&
                    dense.shape(0) == dense_normals.shape(0) && dense.shape(0) == apparent_normals.shape(0),
                "samples, normals and weights differ in length");
        for (size_t i = 0; i < grid.size(); ++i)
            require(grid.data()[i] == none || grid.data()[i] < dense.shape(0),
                    "the grid names a sample that does not exist");
        Surface s;
        s.exists = samples.shape(0) > 0;
        s.p = copied(samples), s.n = copied(normals);
        s.w.assign(weights.data(), weights.data() + weights.shape(0));
        for (size_t i = 0; i < dense.shape(0); ++i) s.dense.push_back({vectors(dense)[i], vectors(dense_normals)[i]});
        s.apparent = copied(apparent_normals);
        s.grid.assign(grid.data(), grid.data() + grid.size());
        for (int i = 0; i < 3; ++i) s.dims[i] = int(grid.shape(i));
        s.grid_origin = {std::get<0>(origin), std::get<1>(origin), std::get<2>(origin)};
        s.centre = {std::get<0>(centre), std::get<1>(centre), std::get<2>(centre)};
        s.inverse = 1 / cell, s.slack = slack, s.cell_slack = .5f * cell, s.radius = radius, s.size = size,
        s.area = area, s.weight = weight;
        self.finish(s);
        self.surface[part] = std::move(s);
    },
             "part"_a, "samples"_a, "normals"_a, "weights"_a, "dense"_a, "dense_normals"_a, "apparent_normals"_a,
             "grid"_a, "origin"_a, "cell"_a, "slack"_a, "centre"_a, "radius"_a, "size"_a, "area"_a, "weight"_a);
    type.def("restricted", [](const Articulated &self, Doubles lower, Doubles upper) {
        require(int(lower.shape(0)) == self.joints && int(upper.shape(0)) == self.joints,
                "one bound per joint is needed");
        Articulated copy = self;
        for (int j = 0; j < self.joints; ++j) {
            copy.lower[j] = lower.data()[j], copy.upper[j] = upper.data()[j];
            copy.wraps[j] = self.wraps[j] && copy.lower[j] <= self.lower[j] && copy.upper[j] >= self.upper[j];
        }
        return copy;
    }, "lower"_a, "upper"_a);
    type.def_prop_ro("parent", [](const Articulated &self) { return to_numpy(std::vector<int>(self.parent)); },
                     nb::rv_policy::move);
    type.def_prop_ro("actuated", [](const Articulated &self) { return to_numpy(std::vector<int>(self.actuated)); },
                     nb::rv_policy::move);
    type.def_prop_ro("travel", [](const Articulated &self) {
        std::vector<double> travel(self.parts, 0.);
        for (int p = 1; p < self.parts; ++p)
            if (self.prismatic[p])
                travel[p] =
                    std::abs(self.multiplier[p]) * (self.upper[self.actuated[p]] - self.lower[self.actuated[p]]);
        return to_numpy(std::move(travel));
    }, nb::rv_policy::move);
    type.def_prop_ro("limits", [](const Articulated &self) {
        return nb::make_tuple(to_numpy(std::vector<double>(self.lower)), to_numpy(std::vector<double>(self.upper)));
    }, nb::rv_policy::move);
    type.def("closed",
             [](const Articulated &self, const std::vector<int> &chain, Placements above, Placements below,
                double open_turn, double open_slide, double beyond) {
        require(chain.size() == 1 || chain.size() == 2, "a chain has one joint, or two");
        for (const int part : chain) require(part > 0 && part < self.parts, "no joint holds such a part");
        require(chain.size() == 1 || self.parent[chain[1]] == chain[0], "the joints of a chain follow one another");
        const auto T_above = read_placements(above), T_below = read_placements(below);
        const size_t a = T_above.size(), b = T_below.size(), n = chain.size();
        std::vector<double> values(a * b * n);
        std::vector<uint8_t> fits(a * b);
        unlocked([&] {
            for (size_t i = 0; i < a * b; ++i)
                fits[i] =
                    self.close(chain, T_above[i / b], T_below[i % b], {open_turn, open_slide, beyond}, &values[n * i]);
        });
        return nb::make_tuple(to_numpy(std::move(values), {a, b, n}), to_numpy(std::move(fits), {a, b}));
    },
             "chain"_a, "above"_a, "below"_a, "open_turn"_a, "open_slide"_a, "beyond"_a);
    type.def("forward", [](const Articulated &self, Placements bases, Matrix values) {
        const auto configurations = read_configurations(self, bases, values);
        std::vector<double> out(16 * configurations.size() * self.parts);
        std::vector<Rigid> T(self.parts);
        for (size_t c = 0; c < configurations.size(); ++c) {
            self.forward(configurations[c].base, configurations[c].values.data(), T.data());
            for (int p = 0; p < self.parts; ++p) write_placement(T[p], &out[16 * (c * self.parts + p)]);
        }
        return to_numpy(std::move(out), {configurations.size(), size_t(self.parts), 4, 4});
    }, "bases"_a, "values"_a);
}

void bind_meshes(nb::module_ &m) {
    nb::class_<TriangleMesh> type(m, "TriangleMesh");
    type.def("__init__", [](TriangleMesh *self, Points vertices, In<int, nb::shape<-1, 3>> faces) {
        require_finite(vertices, "vertices must be finite");
        for (size_t i = 0; i < faces.size(); ++i)
            require(faces.data()[i] >= 0 && faces.data()[i] < int(vertices.shape(0)),
                    "a face names a vertex that does not exist");
        nb::gil_scoped_release release;
        new (self) TriangleMesh(vectors(vertices), faces.data(), faces.shape(0));
    }, "vertices"_a, "faces"_a);
    m.def("closest_on_meshes",
          [](std::vector<const TriangleMesh *> meshes, Placements placements, Points points, float reach, int threads) {
        require(placements.shape(0) == meshes.size(), "one placement per mesh is needed");
        for (const TriangleMesh *mesh : meshes) require(mesh != nullptr, "None is no mesh");
        const std::vector<Rigid> T = read_placements(placements);
        std::vector<Vec> closest = copied(points);
        std::vector<int> owner;
        unlocked([&] { closest_on_meshes(meshes, T, reach, threads, closest, owner); });
        return nb::make_tuple(to_numpy(closest), to_numpy(std::move(owner)));
    }, "meshes"_a, "placements"_a, "points"_a, "reach"_a, "threads"_a);
}

} // namespace pwr
