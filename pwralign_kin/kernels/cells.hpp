// Points sorted into the cells of a uniform grid, for neighbour queries within one cell size.
#pragma once
#include "linalg.hpp"
#include <numeric>

namespace pwr {

class Cells {
  public:
    // `size` is the largest radius that `visit` answers.
    Cells(const Vec *points, int64_t count, float size) : points(points), inverse(1.f / size) {
        origin = count ? points[0] : Vec{0, 0, 0};
        for (int64_t i = 0; i < count; ++i) {
            origin.x = std::min(origin.x, points[i].x);
            origin.y = std::min(origin.y, points[i].y);
            origin.z = std::min(origin.z, points[i].z);
        }
        std::vector<uint64_t> raw(count);
        for (int64_t i = 0; i < count; ++i) raw[i] = key(points[i]);
        order.resize(count);
        std::iota(order.begin(), order.end(), 0);
        std::sort(order.begin(), order.end(),
                  [&](int a, int b) { return raw[a] != raw[b] ? raw[a] < raw[b] : a < b; });
        keys.resize(count);
        for (int64_t i = 0; i < count; ++i) keys[i] = raw[order[i]];
    }

    // Call f(index, squared distance) for every point within `radius` (at most the cell size) of p.
    template <typename F> void visit(Vec p, float radius, F &&f) const {
        const int64_t cx = coordinate(p.x - origin.x), cy = coordinate(p.y - origin.y),
                      cz = coordinate(p.z - origin.z);
        const float limit = radius * radius;
        for (int64_t x = cx - 1; x <= cx + 1; ++x)
            for (int64_t y = cy - 1; y <= cy + 1; ++y) {
                // The three cells along z are neighbours in the sorted order.
                const uint64_t first = pack(x, y, cz - 1), last = pack(x, y, cz + 1);
                auto at = std::lower_bound(keys.begin(), keys.end(), first) - keys.begin();
                for (; at < int64_t(keys.size()) && keys[at] <= last; ++at) {
                    const Vec d = points[order[at]] - p;
                    const float squared = dot(d, d);
                    if (squared <= limit) f(order[at], squared);
                }
            }
    }
    uint64_t key(Vec p) const {
        return pack(coordinate(p.x - origin.x), coordinate(p.y - origin.y), coordinate(p.z - origin.z));
    }

    std::vector<uint64_t> keys; // sorted
    std::vector<int> order;     // point of each key

  private:
    int64_t coordinate(float v) const { return int64_t(std::floor(v * inverse)); }
    static uint64_t pack(int64_t x, int64_t y, int64_t z) {
        const int64_t bias = 1 << 20;
        return (uint64_t(x + bias) << 42) | (uint64_t(y + bias) << 21) | uint64_t(z + bias);
    }
    const Vec *points;
    float inverse;
    Vec origin;
};

} // namespace pwr
