// Arrays in and out of the bindings, and the checks that all of them share.
#pragma once
#include "../articulated.hpp"
#include <cmath>
#include <cstdint>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>
#include <stdexcept>
#include <utility>
#include <vector>

namespace nb = nanobind;
using namespace nb::literals;

namespace pwr {

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
inline Out<float> to_numpy(const std::vector<Vec> &points) {
    std::vector<float> flat(3 * points.size());
    for (size_t i = 0; i < points.size(); ++i)
        flat[3 * i] = points[i].x, flat[3 * i + 1] = points[i].y, flat[3 * i + 2] = points[i].z;
    return to_numpy(std::move(flat), {points.size(), 3});
}
inline const Vec *vectors(const Points &points) { return reinterpret_cast<const Vec *>(points.data()); }
inline std::vector<Vec> copied(const Points &points) { return {vectors(points), vectors(points) + points.shape(0)}; }

// What `work` returns, made while other Python threads may run.
template <typename Work> auto unlocked(Work work) {
    nb::gil_scoped_release release;
    return work();
}
inline void require(bool condition, const char *message) {
    if (!condition) throw std::invalid_argument(message);
}
inline Rigid read_placement(const double *m) {
    return {{m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]}, {m[3], m[7], m[11]}};
}
inline std::vector<Rigid> read_placements(const Placements &placements) {
    std::vector<Rigid> T;
    for (size_t i = 0; i < placements.shape(0); ++i) T.push_back(read_placement(placements.data() + 16 * i));
    return T;
}
inline std::vector<Rigid> part_placements(const Articulated &model, const Placements &placements) {
    require(int(placements.shape(0)) == model.parts, "one placement per part is needed");
    return read_placements(placements);
}
inline void write_placement(const Rigid &T, double *m) {
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) m[4 * i + j] = T.R[3 * i + j];
        m[4 * i + 3] = T.t[i];
    }
    m[12] = m[13] = m[14] = 0, m[15] = 1;
}
inline void require_finite(const Points &points, const char *message) {
    for (size_t i = 0; i < points.size(); ++i) require(std::isfinite(points.data()[i]), message);
}
// Points can be sorted into cells of this size: numbers of cells along one side have 20 bits (`pack_cell`).
inline void require_cells(const Points &points, float cell) {
    require(std::isfinite(cell) && cell > 0, "cells need a positive size");
    const float most = cell * (1 << 20);
    for (size_t i = 0; i < points.size(); ++i)
        require(std::abs(points.data()[i]) < most, "points must be finite, and not too far away for cells so small");
}

} // namespace pwr
