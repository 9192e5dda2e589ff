// Bindings of what is told of points alone.
#include "../cloud.hpp"
#include "../ordering.hpp"
#include "../surface.hpp"
#include "arrays.hpp"
#include "bindings.hpp"
#include <limits>

namespace pwr {

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

} // namespace pwr
