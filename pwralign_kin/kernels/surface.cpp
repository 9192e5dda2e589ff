#include "surface.hpp"
#include "cells.hpp"

namespace pwr {

std::vector<int> thin(const Vec *points, int64_t count, float radius) {
    const Cells cells(points, count, radius);
    std::vector<uint8_t> dropped(count, 0);
    std::vector<int> kept;
    for (int64_t i = 0; i < count; ++i) {
        if (dropped[i]) continue;
        kept.push_back(int(i));
        cells.visit(points[i], radius, [&](int j, float) { dropped[j] = 1; });
    }
    return kept;
}

std::vector<int> farthest_points(const Vec *points, int64_t available, int64_t count) {
    count = std::min(count, available);
    std::vector<int> chosen;
    if (count == 0) return chosen;
    double mean[3] = {0, 0, 0};
    for (int64_t i = 0; i < available; ++i) mean[0] += points[i].x, mean[1] += points[i].y, mean[2] += points[i].z;
    const Vec centre{float(mean[0] / available), float(mean[1] / available), float(mean[2] / available)};
    std::vector<float> nearest(available, 1e30f);
    Vec last = centre;
    for (int64_t k = 0; k <= count; ++k) {
        int best = 0;
        for (int64_t i = 0; i < available; ++i) {
            const Vec d = points[i] - last;
            nearest[i] = std::min(nearest[i], dot(d, d));
            if (nearest[i] > nearest[best]) best = int(i);
        }
        if (k == count) break;
        chosen.push_back(best);
        last = points[best];
        if (k == 0) std::fill(nearest.begin(), nearest.end(), 1e30f); // the mean itself is no sample
    }
    return chosen;
}

std::vector<uint16_t> closest_sample_grid(const Vec *samples, int64_t count, Vec origin, float cell, const int *dims,
                                          float band) {
    const int nx = dims[0], ny = dims[1], nz = dims[2];
    std::vector<uint16_t> grid(int64_t(nx) * ny * nz, none);
    std::vector<float> squared(grid.size(), 1e30f);
    auto centre = [&](int i, int j, int k) {
        return Vec{origin.x + (i + .5f) * cell, origin.y + (j + .5f) * cell, origin.z + (k + .5f) * cell};
    };
    auto offer = [&](int i, int j, int k, uint16_t sample) {
        if (sample == none) return;
        const int64_t at = (int64_t(i) * ny + j) * nz + k;
        if (grid[at] == sample) return;
        const Vec d = samples[sample] - centre(i, j, k);
        const float value = dot(d, d);
        if (value < squared[at]) squared[at] = value, grid[at] = sample;
    };
    for (int64_t s = 0; s < count; ++s) {
        const int i = std::clamp(int((samples[s].x - origin.x) / cell), 0, nx - 1);
        const int j = std::clamp(int((samples[s].y - origin.y) / cell), 0, ny - 1);
        const int k = std::clamp(int((samples[s].z - origin.z) / cell), 0, nz - 1);
        for (int a = std::max(0, i - 1); a <= std::min(nx - 1, i + 1); ++a)
            for (int b = std::max(0, j - 1); b <= std::min(ny - 1, j + 1); ++b)
                for (int c = std::max(0, k - 1); c <= std::min(nz - 1, k + 1); ++c) offer(a, b, c, uint16_t(s));
    }
    // A forward and a backward sweep over the causal half of the 26 neighbours.
    for (int direction = 1; direction >= -1; direction -= 2) {
        const int i0 = direction > 0 ? 0 : nx - 1, j0 = direction > 0 ? 0 : ny - 1, k0 = direction > 0 ? 0 : nz - 1;
        for (int i = i0; i >= 0 && i < nx; i += direction)
            for (int j = j0; j >= 0 && j < ny; j += direction) {
                for (int k = k0; k >= 0 && k < nz; k += direction)
                    for (int a = -1; a <= 0; ++a)
                        for (int b = -1; b <= (a < 0 ? 1 : 0); ++b)
                            for (int c = -1; c <= (a < 0 || b < 0 ? 1 : -1); ++c) {
                                const int x = i + direction * a, y = j + direction * b, z = k + direction * c;
                                if (x < 0 || y < 0 || z < 0 || x >= nx || y >= ny || z >= nz) continue;
                                offer(i, j, k, grid[(int64_t(x) * ny + y) * nz + z]);
                            }
                for (int k = nz - 1 - k0; k >= 0 && k < nz; k -= direction)
                    if (k + direction >= 0 && k + direction < nz)
                        offer(i, j, k, grid[(int64_t(i) * ny + j) * nz + k + direction]);
            }
    }
    const float limit = band * band;
    for (size_t at = 0; at < grid.size(); ++at)
        if (squared[at] > limit) grid[at] = none;
    return grid;
}

} // namespace pwr
