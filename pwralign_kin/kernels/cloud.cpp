#include "cloud.hpp"
#include "cells.hpp"
#include "parallel.hpp"

namespace pwr {

std::vector<Vec> voxel_means(const Vec *points, int64_t count, float cell, std::vector<int> &counts,
                             std::vector<int> &cell_of_point) {
    const Cells cells(points, count, cell);
    std::vector<Vec> means;
    counts.clear();
    cell_of_point.assign(count, -1);
    for (int64_t at = 0; at < count;) {
        double sum[3] = {0, 0, 0};
        const int64_t first = at;
        for (; at < count && cells.keys[at] == cells.keys[first]; ++at) {
            const Vec p = points[cells.order[at]];
            sum[0] += p.x, sum[1] += p.y, sum[2] += p.z;
            cell_of_point[cells.order[at]] = int(means.size());
        }
        const double n = double(at - first);
        means.push_back({float(sum[0] / n), float(sum[1] / n), float(sum[2] / n)});
        counts.push_back(int(at - first));
    }
    return means;
}

LocalPlanes local_planes(const Vec *points, int64_t count, float radius, int threads) {
    const Cells cells(points, count, radius);
    LocalPlanes out;
    out.normal.resize(count), out.mean.resize(count), out.variance.resize(count), out.neighbours.resize(count);
    const int64_t block = 256;
    parallel_for((count + block - 1) / block, threads, [&](int64_t b) {
        for (int64_t i = b * block; i < std::min(count, (b + 1) * block); ++i) {
            double s[3] = {0, 0, 0}, C[3][3] = {};
            int n = 0;
            cells.visit(points[i], radius, [&](int j, float) {
                const Vec d = points[j] - points[i];
                const double v[3] = {d.x, d.y, d.z};
                for (int a = 0; a < 3; ++a) {
                    s[a] += v[a];
                    for (int c = a; c < 3; ++c) C[a][c] += v[a] * v[c];
                }
                ++n;
            });
            for (int a = 0; a < 3; ++a)
                for (int c = a; c < 3; ++c) C[a][c] = C[c][a] = C[a][c] / n - s[a] / n * s[c] / n;
            double values[3], V[3][3];
            eigen_symmetric(C, values, V);
            out.normal[i] = {float(V[0][0]), float(V[1][0]), float(V[2][0])};
            out.mean[i] = points[i] + Vec{float(s[0] / n), float(s[1] / n), float(s[2] / n)};
            out.variance[i] = float(std::max(0., values[0]));
            out.neighbours[i] = n;
        }
    });
    return out;
}

std::vector<float> openness(const Vec *points, const Vec *normals, int64_t count, float cell, int threads) {
    Vec low = points[0], high = points[0];
    for (int64_t i = 0; i < count; ++i) {
        low = {std::min(low.x, points[i].x), std::min(low.y, points[i].y), std::min(low.z, points[i].z)};
        high = {std::max(high.x, points[i].x), std::max(high.y, points[i].y), std::max(high.z, points[i].z)};
    }
    const float inverse = 1.f / cell;
    const Vec origin = low - Vec{cell, cell, cell};
    const int nx = int((high.x - origin.x) * inverse) + 2, ny = int((high.y - origin.y) * inverse) + 2,
              nz = int((high.z - origin.z) * inverse) + 2;
    std::vector<uint8_t> occupied(int64_t(nx) * ny * nz, 0);
    for (int64_t i = 0; i < count; ++i) {
        const Vec p = inverse * (points[i] - origin);
        occupied[(int64_t(p.x) * ny + int64_t(p.y)) * nz + int64_t(p.z)] = 1;
    }
    // A spherical Fibonacci set: directions spread evenly, the same for every cloud.
    std::vector<Vec> directions(40);
    for (size_t k = 0; k < directions.size(); ++k) {
        const float z = 1 - 2 * (k + .5f) / directions.size(), r = std::sqrt(1 - z * z), a = 2.39996323f * k;
        directions[k] = {r * std::cos(a), r * std::sin(a), z};
    }
    std::vector<float> out(count, 0.f);
    const int64_t block = 256;
    parallel_for((count + block - 1) / block, threads, [&](int64_t b) {
        for (int64_t i = b * block; i < std::min(count, (b + 1) * block); ++i)
            for (const Vec &direction : directions) {
                // The march starts two cells out, past the surface that the point itself lies on.
                Vec p = inverse * (points[i] - origin) + 2.2f * direction;
                bool free = true;
                while (true) {
                    const int x = int(std::floor(p.x)), y = int(std::floor(p.y)), z = int(std::floor(p.z));
                    if (x < 0 || y < 0 || z < 0 || x >= nx || y >= ny || z >= nz) break;
                    if (occupied[(int64_t(x) * ny + y) * nz + z]) {
                        free = false;
                        break;
                    }
                    p = p + direction;
                }
                if (free) out[i] += dot(direction, normals[i]);
            }
    });
    return out;
}

std::vector<int> components(const Vec *points, int64_t count, float radius) {
    const Cells cells(points, count, radius);
    std::vector<int> label(count, -1), open;
    int next = 0;
    for (int64_t first = 0; first < count; ++first) {
        if (label[first] >= 0) continue;
        label[first] = next;
        open.push_back(int(first));
        while (!open.empty()) {
            const int i = open.back();
            open.pop_back();
            cells.visit(points[i], radius, [&](int j, float) {
                if (label[j] >= 0) return;
                label[j] = next;
                open.push_back(j);
            });
        }
        ++next;
    }
    return label;
}

Plane dominant_plane(const Vec *points, const Vec *normals, int64_t count, float tolerance, int trials,
                     uint64_t seed) {
    Plane best{{0, 0, 0}, 0, 0};
    if (count == 0) return best;
    Random random(seed);
    for (int t = 0; t < trials; ++t) {
        const uint32_t i = random.below(uint32_t(count));
        const Vec n = normals[i];
        const float offset = dot(n, points[i]);
        int64_t inliers = 0;
        for (int64_t j = 0; j < count; ++j)
            inliers += std::abs(dot(n, points[j]) - offset) < tolerance && std::abs(dot(n, normals[j])) > .8f;
        if (inliers > best.inliers) best = {n, offset, inliers};
    }
    return best;
}

} // namespace pwr
