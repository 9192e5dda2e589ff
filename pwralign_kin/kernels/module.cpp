// Python bindings: arrays in, arrays out. Lengths are in units of the model's diagonal.
#include "cloud.hpp"
#include "search.hpp"
#include "surface_mixture.hpp"
#include "tracking.hpp"
#include "triangles.hpp"
#include <limits>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>
#include <stdexcept>

namespace nb = nanobind;
using namespace nb::literals;
using namespace pwr;

namespace {

template <typename T, typename... Shape> using In = nb::ndarray<const T, Shape..., nb::c_contig, nb::device::cpu>;
using Points = In<float, nb::shape<-1, 3>>;
using Placements = In<double, nb::shape<-1, 4, 4>>;
using Matrix = In<double, nb::shape<-1, -1>>;
using FloatMatrix = In<float, nb::shape<-1, -1>>;
using Doubles = In<double, nb::shape<-1>>;
using Floats = In<float, nb::shape<-1>>;
using Ints = In<int32_t, nb::shape<-1>>;
using Bytes = In<uint8_t, nb::shape<-1>>;
template <typename T> using Out = nb::ndarray<nb::numpy, T>;

template <typename T> Out<T> to_numpy(std::vector<T> values, std::initializer_list<size_t> shape) {
    auto *kept = new std::vector<T>(std::move(values));
    nb::capsule owner(kept, [](void *p) noexcept { delete static_cast<std::vector<T> *>(p); });
    return Out<T>(kept->data(), shape, owner);
}
template <typename T> Out<T> to_numpy(std::vector<T> values) {
    const size_t size = values.size();
    return to_numpy(std::move(values), {size});
}
Out<float> to_numpy(const std::vector<Vec> &points) {
    std::vector<float> flat(3 * points.size());
    for (size_t i = 0; i < points.size(); ++i)
        flat[3 * i] = points[i].x, flat[3 * i + 1] = points[i].y, flat[3 * i + 2] = points[i].z;
    return to_numpy(std::move(flat), {points.size(), 3});
}
const Vec *vectors(const Points &points) { return reinterpret_cast<const Vec *>(points.data()); }
std::vector<Vec> copied(const Points &points) { return {vectors(points), vectors(points) + points.shape(0)}; }

// What `work` returns, made while other Python threads may run.
template <typename Work> auto unlocked(Work work) {
    nb::gil_scoped_release release;
    return work();
}
void require(bool condition, const char *message) {
    if (!condition) throw std::invalid_argument(message);
}
Rigid read_placement(const double *m) {
    return {{m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, {m[3], m[7], m[11]}};
}
std::vector<Rigid> read_placements(const Placements &placements) {
    std::vector<Rigid> T;
    for (size_t i = 0; i < placements.shape(0); ++i) T.push_back(read_placement(placements.data() + 16 * i));
    return T;
}
std::vector<Rigid> part_placements(const Articulated &model, const Placements &placements) {
    require(int(placements.shape(0)) == model.parts, "one placement per part is needed");
    return read_placements(placements);
}
void write_placement(const Rigid &T, double *m) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) m[4 * i + j] = T.R[3 * i + j];
        m[4 * i + 3] = T.t[i];
    }
    m[12] = m[13] = m[14] = 0, m[15] = 1;
}
void require_finite(const Points &points, const char *message) {
    for (size_t i = 0; i < points.size(); ++i) require(std::isfinite(points.data()[i]), message);
}
// Points can be sorted into cells of this size: numbers of cells along one side have 20 bits (`pack_cell`).
void require_cells(const Points &points, float cell) {
    require(std::isfinite(cell) && cell > 0, "cells need a positive size");
    const float most = cell * (1 << 20);
    for (size_t i = 0; i < points.size(); ++i)
        require(std::abs(points.data()[i]) < most, "points must be finite, and not too far away for cells so small");
}
std::vector<Configuration> read_configurations(const Articulated &model, const Placements &bases,
                                               const Matrix &values) {
    require(bases.shape(0) == values.shape(0) && int(values.shape(1)) == model.joints,
            "bases (m, 4, 4) and values (m, k) do not match the model");
    std::vector<Configuration> out(bases.shape(0));
    for (size_t i = 0; i < out.size(); ++i)
        out[i] = {read_placement(bases.data() + 16 * i),
                  {values.data() + i * model.joints, values.data() + (i + 1) * model.joints}};
    return out;
}
nb::tuple write_configurations(const Articulated &model, const std::vector<Configuration> &configurations) {
    const size_t m = configurations.size(), k = model.joints;
    std::vector<double> bases(16 * m), values(k * m);
    std::vector<float> scores(m);
    for (size_t i = 0; i < m; ++i) {
        write_placement(configurations[i].base, &bases[16 * i]);
        std::copy(configurations[i].values.begin(), configurations[i].values.end(), values.begin() + k * i);
        scores[i] = configurations[i].score;
    }
    return nb::make_tuple(to_numpy(std::move(bases), {m, 4, 4}), to_numpy(std::move(values), {m, k}),
                          to_numpy(std::move(scores)));
}
void require_surface(const Articulated &model, int part) {
    require(part >= 0 && part < model.parts && model.surface[part].exists, "a hypothesis needs a part with a surface");
}
std::vector<Hypothesis> read_hypotheses(const Articulated &model, const Ints &parts, const Placements &placements) {
    require(parts.shape(0) == placements.shape(0), "parts (m,) and placements (m, 4, 4) differ in length");
    std::vector<Hypothesis> out(parts.shape(0));
    for (size_t i = 0; i < out.size(); ++i) {
        const int part = parts.data()[i];
        require_surface(model, part);
        out[i] = {part, read_placement(placements.data() + 16 * i), 0};
    }
    return out;
}
nb::tuple write_hypotheses(const std::vector<Hypothesis> &hypotheses) {
    std::vector<int> parts;
    std::vector<double> placements(16 * hypotheses.size());
    std::vector<float> scores;
    for (size_t i = 0; i < hypotheses.size(); ++i) {
        parts.push_back(hypotheses[i].part);
        write_placement(hypotheses[i].T, &placements[16 * i]);
        scores.push_back(hypotheses[i].score);
    }
    return nb::make_tuple(to_numpy(std::move(parts)), to_numpy(std::move(placements), {hypotheses.size(), 4, 4}),
                          to_numpy(std::move(scores)));
}
// Where the parts of a configuration are, and which of them may own points: those in the mask that have a surface.
struct PlacedParts {
    std::vector<Rigid> T;
    std::vector<uint8_t> used;
    PlacedParts(const Articulated &model, const Placements &placements, const Bytes &mask)
        : T(part_placements(model, placements)) {
        require(int(mask.shape(0)) == model.parts, "one entry of the mask per part is needed");
        for (int p = 0; p < model.parts; ++p) used.push_back(mask.data()[p] && model.surface[p].exists);
    }
};
nb::tuple write_assignment(Assignment a) {
    return nb::make_tuple(to_numpy(std::move(a.distance)), to_numpy(std::move(a.part)), to_numpy(std::move(a.sample)));
}

void bind_clouds(nb::module_ &m) {
    m.def("thin", [](Points points, float radius) {
        auto kept = unlocked([&] { return thin(vectors(points), points.shape(0), radius); });
        return to_numpy(std::move(kept));
    }, "points"_a, "radius"_a);
    m.def("farthest_points", [](Points points, int count) {
        return to_numpy(farthest_points(vectors(points), points.shape(0), count));
    }, "points"_a, "count"_a);
    m.def("closest_sample_grid",
          [](Points samples, std::tuple<float, float, float> origin, float cell, std::tuple<int, int, int> dims,
             float band) {
        const int d[3] = {std::get<0>(dims), std::get<1>(dims), std::get<2>(dims)};
        require(samples.shape(0) < none, "a surface has at most 65534 samples");
        require(cell > 0 && d[0] > 0 && d[1] > 0 && d[2] > 0, "a grid needs cells of a positive size");
        auto grid = unlocked([&] {
            return closest_sample_grid(vectors(samples), samples.shape(0),
                                       {std::get<0>(origin), std::get<1>(origin), std::get<2>(origin)}, cell, d, band);
        });
        return to_numpy(std::move(grid));
    },
          "samples"_a, "origin"_a, "cell"_a, "dims"_a, "band"_a);
    m.def("voxel_means", [](Points points, float cell) {
        require(cell > 0, "cells need a positive size");
        std::vector<int> counts, cells;
        auto means = unlocked([&] { return voxel_means(vectors(points), points.shape(0), cell, counts, cells); });
        return nb::make_tuple(to_numpy(means), to_numpy(std::move(counts)), to_numpy(std::move(cells)));
    }, "points"_a, "cell"_a);
    m.def("first_of_cells", [](Ints cell_of_point, Ints order, int each) {
        const size_t count = cell_of_point.shape(0);
        require(order.shape(0) == count && each > 0,
                "an order of all points, and at least one of each cell, are needed");
        int cells = 0;
        for (size_t i = 0; i < count; ++i) {
            const int cell = cell_of_point.data()[i], point = order.data()[i];
            require(cell >= 0 && cell < std::numeric_limits<int>::max() && point >= 0 && size_t(point) < count,
                    "cells count from 0, and points are among those given");
            cells = std::max(cells, cell + 1);
        }
        return to_numpy(first_of_cells(cell_of_point.data(), {order.data(), order.data() + count}, cells, each));
    }, "cell_of_point"_a, "order"_a, "each"_a);
    m.def("along_curve", [](Points points) {
        require(points.shape(0) > 0, "a curve leads through at least one point");
        Vec low = vectors(points)[0], high = low;
        for (size_t i = 0; i < points.shape(0); ++i) {
            const Vec p = vectors(points)[i];
            low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
            high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
        }
        return to_numpy(along_curve(vectors(points), 1, int64_t(points.shape(0)), low,
                                    std::max({high.x - low.x, high.y - low.y, high.z - low.z})));
    }, "points"_a);
    m.def("local_planes", [](Points points, float radius, int threads) {
        require_cells(points, radius);
        auto planes = unlocked([&] { return local_planes(vectors(points), points.shape(0), radius, threads); });
        return nb::make_tuple(to_numpy(planes.normal), to_numpy(planes.mean), to_numpy(planes.variances),
                              to_numpy(std::move(planes.neighbours)));
    }, "points"_a, "radius"_a, "threads"_a);
    m.def("apparent_normals", [](Points points, Points normals, float radius, int threads) {
        require_cells(points, radius);
        require(normals.shape(0) == points.shape(0), "one normal per point is needed");
        auto apparent = unlocked(
            [&] { return apparent_normals(vectors(points), vectors(normals), points.shape(0), radius, threads); });
        return to_numpy(apparent);
    }, "points"_a, "normals"_a, "radius"_a, "threads"_a);
    m.def("nearest_neighbours", [](Points points, Points queries, int count, int threads) {
        require(count > 0, "at least one neighbour is looked for");
        auto near = unlocked([&] {
            return nearest_neighbours(vectors(points), points.shape(0), vectors(queries), queries.shape(0), count,
                                      threads);
        });
        const size_t asked = queries.shape(0), each = near.each;
        return nb::make_tuple(to_numpy(std::move(near.distance), {asked, each}),
                              to_numpy(std::move(near.point), {asked, each}));
    }, "points"_a, "queries"_a, "count"_a, "threads"_a);
    m.def("neighbourhood_variances", [](Points points, Points queries, const std::vector<int> &sizes, int threads) {
        require(!sizes.empty() && sizes.front() > 3 && sizes.back() <= int64_t(points.shape(0)),
                "a neighbourhood has more than three of the points");
        auto variances = unlocked([&] {
            return neighbourhood_variances(vectors(points), points.shape(0), vectors(queries), queries.shape(0), sizes,
                                           threads);
        });
        return to_numpy(std::move(variances), {sizes.size(), 3, queries.shape(0)});
    }, "points"_a, "queries"_a, "sizes"_a, "threads"_a);
    m.def("openness", [](Points points, Points normals, float cell, int threads) {
        require_cells(points, cell);
        require(points.shape(0) > 0, "there are no points");
        require(points.shape(0) == normals.shape(0), "points and normals differ in length");
        auto open =
            unlocked([&] { return openness(vectors(points), vectors(normals), points.shape(0), cell, threads); });
        return to_numpy(std::move(open));
    }, "points"_a, "normals"_a, "cell"_a, "threads"_a);
    m.def("components", [](Points points, float radius) {
        require_cells(points, radius);
        auto label = unlocked([&] { return components(vectors(points), points.shape(0), radius); });
        return to_numpy(std::move(label));
    }, "points"_a, "radius"_a);
    m.def("retracted", [](In<double, nb::shape<4, 4>> placement, In<double, nb::shape<6>> twist) {
        Rigid moved = read_placement(placement.data());
        retract(moved, twist.data(), M_PI);
        std::vector<double> out(16);
        write_placement(moved, out.data());
        return to_numpy(std::move(out), {4, 4});
    }, "placement"_a, "twist"_a);
    m.def("first_occurrences", [](In<double, nb::shape<-1, 3>> rows) {
        return to_numpy(unlocked([&] { return first_occurrences(rows.data(), rows.shape(0)); }));
    }, "rows"_a);
    m.def("steps_around", [](Points points, Points normals, double step, int directions) {
        require(points.shape(0) == normals.shape(0), "points and normals differ in length");
        require(directions >= 0, "the number of directions is negative");
        return to_numpy(steps_around(vectors(points), vectors(normals), points.shape(0), step, directions));
    }, "points"_a, "normals"_a, "step"_a, "directions"_a);
    m.def("dominant_plane", [](Points points, Points normals, float tolerance, int trials, uint64_t seed) {
        require(points.shape(0) == normals.shape(0), "points and normals differ in length");
        auto plane = unlocked([&] {
            return dominant_plane(vectors(points), vectors(normals), points.shape(0), tolerance, trials, seed);
        });
        return nb::make_tuple(plane.normal.x, plane.normal.y, plane.normal.z, plane.offset, plane.inliers);
    }, "points"_a, "normals"_a, "tolerance"_a, "trials"_a, "seed"_a);
}

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

void bind_field(nb::module_ &m) {
    nb::class_<ScanField> type(m, "ScanField");
    type.def("__init__",
             [](ScanField *self, Points points, Points normals, Floats weights, Floats areas, Ints regions, float cell,
                float truncation, std::vector<float> sensor_origin, Points depth_points, Points borders, float pixel,
                float tolerance, float shadow, float unreturned, int threads) {
        const size_t count = points.shape(0);
        require(count > 0 && normals.shape(0) == count && weights.shape(0) == count && areas.shape(0) == count &&
                    regions.shape(0) == count,
                "the arrays of the points differ in length");
        require_cells(points, cell);
        require(sensor_origin.empty() || sensor_origin.size() == 3, "a sensor origin has three coordinates");
        const Vec sensor =
            sensor_origin.empty() ? Vec{0, 0, 0} : Vec{sensor_origin[0], sensor_origin[1], sensor_origin[2]};
        nb::gil_scoped_release release;
        new (self) ScanField(copied(points), copied(normals), {weights.data(), weights.data() + count},
                             {areas.data(), areas.data() + count}, {regions.data(), regions.data() + count}, cell,
                             truncation, sensor_origin.empty() ? nullptr : &sensor, copied(depth_points),
                             copied(borders), pixel, tolerance, shadow, unreturned, threads);
    },
             "points"_a, "normals"_a, "weights"_a, "areas"_a, "regions"_a, "cell"_a, "truncation"_a, "sensor_origin"_a,
             "depth_points"_a, "borders"_a, "pixel"_a, "tolerance"_a, "shadow"_a, "unreturned"_a, "threads"_a);
    type.def_ro("unreturned", &ScanField::unreturned);
    type.def("with_unreturned", [](const ScanField &self, float unreturned) {
        ScanField other = self;
        other.unreturned = unreturned;
        return other;
    }, "unreturned"_a);
    type.def("nearest", [](const ScanField &self, Points points, float reach) {
        std::vector<int> nearest(points.shape(0));
        for (size_t i = 0; i < nearest.size(); ++i) {
            const Vec p = vectors(points)[i];
            const int found = self.nearest(p);
            nearest[i] = found >= 0 && norm(self.points[found].p - p) < reach ? found : -1;
        }
        return to_numpy(std::move(nearest));
    }, "points"_a, "reach"_a = std::numeric_limits<float>::infinity());
}

void bind_search(nb::module_ &m) {
    nb::class_<SearchOptions>(m, "SearchOptions")
        .def(nb::init<>())
        .def_rw("support_distance", &SearchOptions::support_distance)
        .def_rw("coverage_distance", &SearchOptions::coverage_distance)
        .def_rw("support_weight", &SearchOptions::support_weight)
        .def_rw("coverage_scale", &SearchOptions::coverage_scale)
        .def_rw("near_penalty", &SearchOptions::near_penalty)
        .def_rw("mismatch_penalty", &SearchOptions::mismatch_penalty)
        .def_rw("normal_penalty", &SearchOptions::normal_penalty)
        .def_rw("solid", &SearchOptions::solid)
        .def_rw("two_way", &SearchOptions::two_way)
        .def_rw("angle_step", &SearchOptions::angle_step)
        .def_rw("beam", &SearchOptions::beam)
        .def_rw("modes", &SearchOptions::modes)
        .def_rw("branch_beam", &SearchOptions::branch_beam)
        .def_rw("threads", &SearchOptions::threads);

    nb::class_<Search> type(m, "Search");
    type.def("__init__",
             [](Search *self, const Articulated &model, const ScanField &field, const SearchOptions &options,
                Doubles neutral) {
        require(int(neutral.shape(0)) == model.joints, "one neutral value per joint is needed");
        new (self) Search(model, field, options, {neutral.data(), neutral.data() + neutral.shape(0)});
    },
             "model"_a, "field"_a, "options"_a, "neutral"_a, nb::keep_alive<1, 2>(), nb::keep_alive<1, 3>());
    type.def("set_prior",
             [](Search &self, Doubles position, double position_deviation, Doubles turn, double turn_deviation,
                Doubles up, double up_deviation, Doubles region, double region_deviation, Doubles values,
                Doubles inverse_deviations) {
        const size_t k = self.model.joints;
        const auto given = [](const Doubles &array, size_t size) { return array.size() == 0 || array.size() == size; };
        require(given(position, 3) && given(turn, 9) && given(up, 6) && given(region, 6),
                "position (3,), turn (9,), up (6,) and region (6,) may be left out by an empty array");
        require(values.size() == k && inverse_deviations.size() == k,
                "one value and one deviation per joint are needed");
        BasePrior base;
        if (position.size()) {
            std::copy_n(position.data(), 3, base.position.emplace().value);
            base.position->deviation = position_deviation;
        }
        if (turn.size()) {
            std::copy_n(turn.data(), 9, base.turn.emplace().R);
            base.turn->deviation = turn_deviation;
        }
        if (up.size()) {
            std::copy_n(up.data(), 3, base.up.emplace().in_scan);
            std::copy_n(up.data() + 3, 3, base.up->in_base);
            base.up->deviation = up_deviation;
        }
        if (region.size()) {
            std::copy_n(region.data(), 3, base.region.emplace().low);
            std::copy_n(region.data() + 3, 3, base.region->high);
            base.region->deviation = region_deviation;
        }
        self.prior = Prior(self.model, base, {values.data(), values.data() + k},
                           {inverse_deviations.data(), inverse_deviations.data() + k});
    },
             "position"_a, "position_deviation"_a, "turn"_a, "turn_deviation"_a, "up"_a, "up_deviation"_a, "region"_a,
             "region_deviation"_a, "values"_a, "inverse_deviations"_a);
    type.def("look_first", [](Search &self, Bytes marked) {
        require(marked.shape(0) == self.field.points.size(), "one mark per scan point is needed");
        self.look_first({marked.data(), marked.data() + marked.shape(0)});
    }, "marked"_a);
    type.def("base_prior", [](const Search &self, Placements base) {
        require(base.shape(0) == 1, "one base is needed");
        std::vector<double> H(36, 0.), g(6, 0.);
        self.prior.base.add(read_placement(base.data()), 1, H.data(), g.data());
        return nb::make_tuple(to_numpy(std::move(H), {6, 6}), to_numpy(std::move(g)));
    }, "base"_a);
    type.def("part_hypotheses",
             [](const Search &self, Ints parts, std::vector<Ints> points, int anchors, uint64_t seed, int keep,
                Floats point_weights) {
        require(points.size() == parts.shape(0), "each part needs the points that it is looked for in");
        std::vector<int> wanted(parts.data(), parts.data() + parts.shape(0));
        for (int p : wanted) require_surface(self.model, p);
        require(point_weights.shape(0) == self.field.points.size(), "one weight per scan point is needed");
        std::vector<std::vector<int>> sampled;
        for (const Ints &own : points) {
            sampled.emplace_back(own.data(), own.data() + own.shape(0));
            for (int k : sampled.back()) require(k >= 0 && k < int(self.field.points.size()), "no such scan point");
        }
        const std::vector<float> weights(point_weights.data(), point_weights.data() + point_weights.shape(0));
        auto found = unlocked([&] { return self.part_hypotheses(wanted, sampled, anchors, seed, keep, weights); });
        return write_hypotheses(found);
    },
             "parts"_a, "points"_a, "anchors"_a, "seed"_a, "keep"_a, "point_weights"_a);
    type.def("correspondence_hypotheses",
             [](const Search &self, int part, Points source, Points source_normals, Points target,
                Points target_normals, Floats weights, uint64_t seed, int keep) {
        const size_t count = source.shape(0);
        require_surface(self.model, part);
        require(source_normals.shape(0) == count && target.shape(0) == count && target_normals.shape(0) == count &&
                    weights.shape(0) == count,
                "the arrays of the correspondences differ in length");
        std::vector<Correspondence> given;
        for (size_t i = 0; i < count; ++i)
            given.push_back({{vectors(source)[i], vectors(source_normals)[i]},
                             {vectors(target)[i], vectors(target_normals)[i]},
                             weights.data()[i]});
        auto found = unlocked([&] { return self.correspondence_hypotheses(part, given, seed, keep); });
        return write_hypotheses(found);
    },
             "part"_a, "source"_a, "source_normals"_a, "target"_a, "target_normals"_a, "weights"_a, "seed"_a, "keep"_a);
    type.def("refine_parts", [](const Search &self, Ints parts, Placements placements, int iterations) {
        auto hypotheses = read_hypotheses(self.model, parts, placements);
        unlocked([&] { self.refine_parts(hypotheses, iterations); });
        return write_hypotheses(hypotheses);
    }, "parts"_a, "placements"_a, "iterations"_a);
    type.def("distinct_parts", [](const Search &self, Ints parts, Placements placements, int keep, float radius) {
        return to_numpy(self.distinct(read_hypotheses(self.model, parts, placements), keep, radius));
    }, "parts"_a, "placements"_a, "keep"_a, "radius"_a);
    type.def("distinct_configurations", [](const Search &self, Placements bases, Matrix values, int keep, float apart) {
        const auto configurations = read_configurations(self.model, bases, values);
        auto kept = unlocked([&] { return self.distinct(configurations, keep, apart); });
        return to_numpy(std::move(kept));
    }, "bases"_a, "values"_a, "keep"_a, "apart"_a);
    type.def("grow", [](const Search &self, Ints parts, Placements placements, int keep) {
        auto roots = read_hypotheses(self.model, parts, placements);
        auto grown = unlocked([&] {
            self.refine_parts(roots, 0);
            return self.grow(roots, keep);
        });
        return write_configurations(self.model, grown);
    }, "parts"_a, "placements"_a, "keep"_a);
    type.def("regrow",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints start, Ints next,
                FloatMatrix weights, int keep) {
        const auto from = read_configurations(self.model, bases, values);
        const size_t count = configuration.shape(0), n = self.model.parts;
        require(start.shape(0) == count && next.shape(0) == count && weights.shape(0) == count && weights.shape(1) == n,
                "the arrays of the tasks differ in length");
        std::vector<RegrowTask> tasks;
        for (size_t t = 0; t < count; ++t) {
            const int c = configuration.data()[t], s = start.data()[t], e = next.data()[t];
            require(c >= 0 && c < int(from.size()) && s >= 0 && s < int(n) && e < int(n),
                    "a task names something that does not exist");
            require(e < 0 || self.model.parent[e] == s || self.model.parent[s] == e, "next is no neighbour of start");
            tasks.push_back({c, s, e, {weights.data() + t * n, weights.data() + (t + 1) * n}});
        }
        auto grown = unlocked([&] { return self.regrow(from, tasks, keep); });
        return write_configurations(self.model, grown);
    },
             "bases"_a, "values"_a, "configuration"_a, "start"_a, "next"_a, "weights"_a, "keep"_a);
    type.def("reach",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints anchor, Ints part,
                Placements placements, uint64_t seed, int starts, int keep, float tolerance) {
        const auto from = read_configurations(self.model, bases, values);
        const size_t count = configuration.shape(0);
        require(anchor.shape(0) == count && part.shape(0) == count && placements.shape(0) == count,
                "the arrays of the tasks differ in length");
        std::vector<ReachTask> tasks;
        for (size_t t = 0; t < count; ++t) {
            const int c = configuration.data()[t], a = anchor.data()[t], p = part.data()[t];
            require(c >= 0 && c < int(from.size()) && a >= 0 && a < self.model.parts && p >= 0 && p < self.model.parts,
                    "a task names something that does not exist");
            require(self.model.surface[p].exists, "a part without a surface cannot be placed");
            tasks.push_back({c, a, p, read_placement(placements.data() + 16 * t)});
        }
        auto found = unlocked([&] { return self.reach(from, tasks, seed, starts, keep, tolerance); });
        return write_configurations(self.model, found);
    },
             "bases"_a, "values"_a, "configuration"_a, "anchor"_a, "part"_a, "placements"_a, "seed"_a, "starts"_a,
             "keep"_a, "tolerance"_a);
    type.def("sweep",
             [](const Search &self, Placements bases, Matrix values, Ints configuration, Ints joint, Bytes base_moves,
                Ints with, int keep) {
        const auto from = read_configurations(self.model, bases, values);
        require(joint.shape(0) == configuration.shape(0) && base_moves.shape(0) == configuration.shape(0) &&
                    with.shape(0) == configuration.shape(0),
                "the arrays of the tasks differ in length");
        std::vector<SweepTask> tasks;
        for (size_t t = 0; t < configuration.shape(0); ++t) {
            const int c = configuration.data()[t], j = joint.data()[t], w = with.data()[t];
            require(c >= 0 && c < int(from.size()) && j >= 0 && j < self.model.joints && w >= -1 &&
                        w < self.model.joints,
                    "a task names something that does not exist");
            tasks.push_back({c, j, base_moves.data()[t] != 0, w});
        }
        auto found = unlocked([&] { return self.sweep(from, tasks, keep); });
        return write_configurations(self.model, found);
    },
             "bases"_a, "values"_a, "configuration"_a, "joint"_a, "base_moves"_a, "with_joint"_a, "keep"_a);
    type.def("score",
             [](const Search &self, Placements bases, Matrix values, int points,
                const std::vector<float> &coverage_distances) {
        require(points > 0, "a score needs points");
        const auto configurations = read_configurations(self.model, bases, values);
        auto scores = unlocked([&] { return self.score(configurations, points, coverage_distances); });
        nb::list out;
        for (Scores &s : scores)
            out.append(
                nb::make_tuple(to_numpy(std::move(s.total)), to_numpy(std::move(s.coverage)),
                               to_numpy(std::move(s.support), {configurations.size(), size_t(self.model.parts)})));
        return out;
    },
             "bases"_a, "values"_a, "points"_a, "coverage_distances"_a);
    type.def("refine",
             [](const Search &self, Placements bases, Matrix values, int points, int iterations, float sigma_first,
                float sigma_last, float support_weight, FloatMatrix part_weights) {
        auto configurations = read_configurations(self.model, bases, values);
        require(part_weights.shape(0) == configurations.size() && int(part_weights.shape(1)) == self.model.parts,
                "part_weights must be (m, parts)");
        const std::vector<float> weights(part_weights.data(), part_weights.data() + part_weights.size());
        unlocked(
            [&] { self.refine(configurations, points, iterations, sigma_first, sigma_last, support_weight, weights); });
        return write_configurations(self.model, configurations);
    },
             "bases"_a, "values"_a, "points"_a, "iterations"_a, "sigma_first"_a, "sigma_last"_a, "support_weight"_a,
             "part_weights"_a);
    type.def("assign", [](const Search &self, Points points, Placements placements, Bytes mask, float cap) {
        const PlacedParts placed(self.model, placements, mask);
        Assignment a;
        {
            nb::gil_scoped_release release;
            const int64_t count = points.shape(0), block = 1024;
            a.distance.resize(count), a.part.resize(count), a.sample.resize(count);
            parallel_for((count + block - 1) / block, self.options.threads, [&](int64_t b) {
                const int64_t from = b * block, size = std::min(block, count - from);
                const Assignment piece =
                    self.assign({vectors(points) + from, 1, size}, placed.T.data(), placed.used.data(), cap);
                std::copy(piece.distance.begin(), piece.distance.end(), a.distance.begin() + from);
                std::copy(piece.part.begin(), piece.part.end(), a.part.begin() + from);
                std::copy(piece.sample.begin(), piece.sample.end(), a.sample.begin() + from);
            });
        }
        return write_assignment(std::move(a));
    }, "points"_a, "placements"_a, "mask"_a, "cap"_a);
    type.def("owners", [](const Search &self, Placements placements, Bytes mask, float cap) {
        const PlacedParts placed(self.model, placements, mask);
        auto a = unlocked([&] { return self.owners(placed.T.data(), placed.used.data(), cap); });
        return write_assignment(std::move(a));
    }, "placements"_a, "mask"_a, "cap"_a);
    type.def("facing", [](const Search &self, Points normals, Placements placements, Ints part, Ints sample) {
        const size_t count = normals.shape(0);
        require(int(placements.shape(0)) == self.model.parts && part.shape(0) == count && sample.shape(0) == count,
                "one placement per part, one part and one sample per normal are needed");
        std::vector<RigidF> F;
        for (int p = 0; p < self.model.parts; ++p) F.push_back(to_float(read_placement(placements.data() + 16 * p)));
        std::vector<float> cosines(count, 0.f);
        for (size_t i = 0; i < count; ++i)
            if (const int p = part.data()[i]; p >= 0) {
                require(p < self.model.parts && sample.data()[i] >= 0 &&
                            size_t(sample.data()[i]) < self.model.surface[p].dense.size(),
                        "a normal names a part or a sample that does not exist");
                cosines[i] = dot(rotate(F[p], self.model.surface[p].dense[sample.data()[i]].n), vectors(normals)[i]);
            }
        return to_numpy(std::move(cosines));
    }, "normals"_a, "placements"_a, "part"_a, "sample"_a);
    type.def("distances",
             [](const Search &self, Points points, Placements placements, Bytes mask, float cap, bool loosely) {
        const size_t n = self.model.parts;
        require(placements.shape(0) % n == 0 && mask.shape(0) == n, "one placement per part is needed");
        const std::vector<Rigid> T = read_placements(placements);
        std::vector<uint8_t> used;
        for (size_t p = 0; p < n; ++p) used.push_back(mask.data()[p] && self.model.surface[p].exists);
        const size_t count = T.size() / n;
        std::vector<float> out(count * points.shape(0));
        {
            nb::gil_scoped_release release;
            self.distances({vectors(points), 1, int64_t(points.shape(0))}, T, int64_t(count), used.data(), cap, loosely,
                           out.data());
        }
        return to_numpy(std::move(out), {count, points.shape(0)});
    }, "points"_a, "placements"_a, "mask"_a, "cap"_a, "loosely"_a);
    type.def("in_sight", [](const Search &self, Placements placements, float distance, float cosine) {
        const std::vector<Rigid> T = part_placements(self.model, placements);
        Search::Sight sight = self.in_sight(T, distance, cosine);
        return nb::make_tuple(to_numpy(std::move(sight.shown)), to_numpy(std::move(sight.near)),
                              to_numpy(std::move(sight.confirmed)));
    }, "placements"_a, "distance"_a, "cosine"_a);
    type.def("normal_equations",
             [](const Search &self, Placements placements, Points points, Points normals, float sigma, float cap,
                float support_weight, Floats part_weights, bool along_rays) {
        const size_t n = self.model.parts;
        require(part_weights.shape(0) == n, "one weight per part is needed");
        const std::vector<Rigid> T = part_placements(self.model, placements);
        require(points.shape(0) == normals.shape(0) && points.shape(0) > 0, "points and normals differ in length");
        std::vector<OrientedPoint> sampled;
        for (size_t i = 0; i < points.shape(0); ++i) sampled.push_back({vectors(points)[i], vectors(normals)[i]});
        std::vector<Normal> normal;
        std::vector<int> counts;
        unlocked([&] {
            normal =
                self.normal_equations(sampled, T, sigma, cap, support_weight, part_weights.data(), along_rays, counts);
        });
        std::vector<double> H, g;
        for (const Normal &part : normal) H.insert(H.end(), part.H, part.H + 36), g.insert(g.end(), part.g, part.g + 6);
        return nb::make_tuple(to_numpy(std::move(H), {n, 6, 6}), to_numpy(std::move(g), {n, 6}),
                              to_numpy(std::move(counts)));
    },
             "placements"_a, "points"_a, "normals"_a, "sigma"_a, "cap"_a, "support_weight"_a, "part_weights"_a,
             "along_rays"_a);
}

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

} // namespace

NB_MODULE(_native, m) {
#if defined(__x86_64__) && defined(__AVX2__)
    if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
        throw std::runtime_error("pwralign_kin was built for processors with AVX2 and FMA; rebuild it on this machine");
#endif
    bind_clouds(m);
    bind_model(m);
    bind_meshes(m);
    bind_field(m);
    bind_search(m);
    bind_mixture(m);
    bind_tracking(m);
}
