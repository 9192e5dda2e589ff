// Points sorted into the cells of a uniform grid, for neighbour queries within one cell size.
#pragma once
#include "lanes.hpp"
#include "ordering.hpp"

namespace pwr {

class Cells {
  public:
    // `size` is the largest radius that `visit` answers.
    Cells(const Vec *points, int64_t count, float size) : size(size), inverse(1.f / size) {
        origin = count ? points[0] : Vec{0, 0, 0};
        Vec high = origin;
        for (int64_t i = 0; i < count; ++i) {
            origin = {std::min(origin.x, points[i].x), std::min(origin.y, points[i].y),
                      std::min(origin.z, points[i].z)};
            high = {std::max(high.x, points[i].x), std::max(high.y, points[i].y), std::max(high.z, points[i].z)};
        }
        nx = coordinate(high.x - origin.x) + 1, ny = coordinate(high.y - origin.y) + 1,
        nz = coordinate(high.z - origin.z) + 1;
        keys.resize(count), sorted.resize(count);
        for (int64_t i = 0; i < count; ++i)
            keys[i] = uint64_t((coordinate(points[i].x - origin.x) * ny + coordinate(points[i].y - origin.y)) * nz +
                               coordinate(points[i].z - origin.z));
        order = sort_keys(keys);
        for (int64_t i = 0; i < count; ++i) sorted[i] = points[order[i]];
        split = SplitPoints(sorted.data(), count, 1);
        if (nx * ny > most_columns * (count + 1000)) return;
        columns.reserve(nx * ny + 1);
        int64_t at = 0;
        for (int64_t column = 0; column < nx * ny; ++column) {
            columns.push_back(int(at));
            while (at < count && keys[at] < uint64_t((column + 1) * nz)) ++at;
        }
        columns.push_back(int(count));
    }

    // Call f(index, squared distance) for every point within `radius` (at most the cell size) of p.
    template <typename F> void visit(Vec p, float radius, F &&f) const {
        const float limit = radius * radius;
        rows_about(p, 1, [&](int64_t first, int64_t last) {
            for (int64_t at = first; at < last; ++at) {
                const Vec d = sorted[at] - p;
                const float squared = dot(d, d);
                if (squared <= limit) f(order[at], squared);
            }
        });
    }

    // Call f(first, last) for the rows of sorted points in the cells up to `rings` away from that of p.
    template <typename F> void rows_about(Vec p, int rings, F &&f) const {
        const int64_t cx = coordinate(p.x - origin.x), cy = coordinate(p.y - origin.y), cz = coordinate(p.z - origin.z);
        const int64_t low = std::max<int64_t>(0, cz - rings), high = std::min(nz - 1, cz + rings);
        if (low > high) return;
        for (int64_t x = std::max<int64_t>(0, cx - rings); x <= std::min(nx - 1, cx + rings); ++x)
            for (int64_t y = std::max<int64_t>(0, cy - rings); y <= std::min(ny - 1, cy + rings); ++y) {
                // The cells along z are neighbours in the sorted order.
                const int64_t column = x * ny + y;
                const uint64_t begin = uint64_t(column * nz + low), end = uint64_t(column * nz + high);
                const auto from = keys.begin() + (columns.empty() ? 0 : columns[column]);
                const auto to = columns.empty() ? keys.end() : keys.begin() + columns[column + 1];
                const int64_t first = std::lower_bound(from, to, begin) - keys.begin();
                int64_t last = first;
                while (last < int64_t(keys.size()) && keys[last] <= end) ++last;
                if (first != last) f(first, last);
            }
    }
    // What all positions in one cell share, and no others.
    uint64_t key(Vec p) const {
        return pack_cell(coordinate(p.x - origin.x), coordinate(p.y - origin.y), coordinate(p.z - origin.z));
    }

    float size;
    std::vector<uint64_t> keys; // number of the cell of each sorted point
    std::vector<int> order;     // each of them among all points
    std::vector<Vec> sorted;    // positions in that order, ...
    SplitPoints split;          // ... and once more, for several at a time

  private:
    int64_t coordinate(float v) const { return int64_t(std::floor(v * inverse)); }
    static constexpr int64_t most_columns = 8; // times the number of points: beyond, the rows are sought among all

    float inverse;
    Vec origin;
    int64_t nx, ny, nz;
    std::vector<int> columns; // where the points of each column of cells along z begin
};

// The points in and around one cell, the same for all that is asked from within that cell.
struct Surroundings {
    SplitPoints points;
    std::vector<int> order; // of each point, among all

    void look(const Cells &cells, Vec p, int rings) {
        points.clear(), order.clear();
        cells.rows_about(p, rings, [&](int64_t first, int64_t last) {
            points.push(cells.split, first, last);
            order.insert(order.end(), cells.order.begin() + first, cells.order.begin() + last);
        });
    }
};

} // namespace pwr
