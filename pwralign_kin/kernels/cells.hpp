// Points sorted into the cells of a uniform grid, for neighbour queries within one cell size.
#pragma once
#include "lanes.hpp"
#include <numeric>

namespace pwr {

class Cells {
  public:
    // `size` is the largest radius that `visit` answers.
    Cells(const Vec *points, int64_t count, float size) : size(size), inverse(1.f / size) {
        origin = count ? points[0] : Vec{0, 0, 0};
        for (int64_t i = 0; i < count; ++i) {
            origin.x = std::min(origin.x, points[i].x);
            origin.y = std::min(origin.y, points[i].y);
            origin.z = std::min(origin.z, points[i].z);
        }
        keys.resize(count), order.resize(count), sorted.resize(count);
        for (int64_t i = 0; i < count; ++i) keys[i] = key(points[i]);
        std::iota(order.begin(), order.end(), 0);
        sort();
        for (int64_t i = 0; i < count; ++i) sorted[i] = points[order[i]];
        split = SplitPoints(sorted.data(), count, 1);
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

    // Call f(first, last) for the rows of sorted points in the cells up to `rings` away from that of p. `hints`, one a row,
    // are where the rows of the cell before began: what is asked in the order of the cells is found near to them.
    template <typename F> void rows_about(Vec p, int rings, F &&f, std::vector<int64_t> *hints = nullptr) const {
        const int64_t cx = coordinate(p.x - origin.x), cy = coordinate(p.y - origin.y), cz = coordinate(p.z - origin.z);
        if (hints) hints->resize((2 * rings + 1) * (2 * rings + 1), 0);
        int row = 0;
        for (int64_t x = cx - rings; x <= cx + rings; ++x)
            for (int64_t y = cy - rings; y <= cy + rings; ++y) {
                // The cells along z are neighbours in the sorted order.
                const int64_t first = first_from(hints ? (*hints)[row] : 0, pack_cell(x, y, cz - rings));
                if (hints) (*hints)[row++] = first;
                const uint64_t end = pack_cell(x, y, cz + rings);
                int64_t last = first;
                while (last < int64_t(keys.size()) && keys[last] <= end) ++last;
                if (first != last) f(first, last);
            }
    }
    uint64_t key(Vec p) const {
        return pack_cell(coordinate(p.x - origin.x), coordinate(p.y - origin.y), coordinate(p.z - origin.z));
    }

    float size;
    std::vector<uint64_t> keys; // sorted
    std::vector<int> order;     // point of each key
    std::vector<Vec> sorted;    // positions in that order, ...
    SplitPoints split;          // ... and once more, for several at a time

  private:
    // Radix sort, byte by byte from the lowest; points of a cell keep their order. Bytes that all keys share are skipped.
    void sort() {
        uint64_t any = 0, all = ~uint64_t(0);
        for (const uint64_t k : keys) any |= k, all &= k;
        std::vector<uint64_t> next_keys(keys.size());
        std::vector<int> next_order(keys.size());
        for (int shift = 0; shift < 64; shift += 8) {
            if (!(((any ^ all) >> shift) & 255)) continue;
            int64_t start[257] = {};
            for (const uint64_t k : keys) ++start[((k >> shift) & 255) + 1];
            for (int v = 0; v < 256; ++v) start[v + 1] += start[v];
            for (size_t i = 0; i < keys.size(); ++i) {
                const int64_t to = start[(keys[i] >> shift) & 255]++;
                next_keys[to] = keys[i], next_order[to] = order[i];
            }
            keys.swap(next_keys), order.swap(next_order);
        }
    }
    // The first of the sorted keys that is no less than `key`, looked for in steps that double from a hint on.
    int64_t first_from(int64_t hint, uint64_t key) const {
        const int64_t size = int64_t(keys.size());
        int64_t low = hint > 0 && keys[hint - 1] >= key ? 0 : hint, step = low > 0 ? 1 : size;
        for (; low + step <= size && keys[low + step - 1] < key; step *= 2) low += step;
        return std::lower_bound(keys.begin() + low, keys.begin() + std::min(size, low + step), key) - keys.begin();
    }
    int64_t coordinate(float v) const { return int64_t(std::floor(v * inverse)); }
    float inverse;
    Vec origin;
};

// The points in and around one cell, the same for all that is asked from within that cell.
struct Surroundings {
    SplitPoints points;
    std::vector<int> order; // of each point, among all
    std::vector<int64_t> hints;

    void look(const Cells &cells, Vec p, int rings) {
        points.clear(), order.clear();
        if (rings != looked) hints.clear(), looked = rings;
        cells.rows_about(p, rings, [&](int64_t first, int64_t last) {
            points.push(cells.split, first, last);
            order.insert(order.end(), cells.order.begin() + first, cells.order.begin() + last);
        }, &hints);
    }

  private:
    int looked = 0;
};

} // namespace pwr
