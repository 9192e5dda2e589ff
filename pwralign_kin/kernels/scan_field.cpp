#include "scan_field.hpp"
#include "parallel.hpp"
#include <algorithm>

namespace pwr {

ScanField::ScanField(std::vector<Vec> positions, std::vector<Vec> normals, std::vector<float> weights,
                     std::vector<float> areas, std::vector<int> regions_of_points, float cell, float truncation,
                     const Vec *sensor_origin, const std::vector<Vec> &depth_points, float pixel, float tolerance,
                     float shadow, int threads)
    : weight(std::move(weights)), area(std::move(areas)), region(std::move(regions_of_points)), has_origin(sensor_origin != nullptr), sensor(sensor_origin ? *sensor_origin : Vec{0, 0, 0}), cell(cell),
      inverse(1.f / cell) {
    Vec low{1e30f, 1e30f, 1e30f}, high{-1e30f, -1e30f, -1e30f};
    auto include = [&](Vec p) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    };
    for (size_t i = 0; i < positions.size(); ++i) {
        points.push_back({positions[i], normals[i]});
        include(positions[i]);
        if (has_origin) {
            const Vec ray = positions[i] - sensor;
            include(positions[i] + (shadow / std::max(norm(ray), 1e-6f)) * ray);
        }
    }
    const float margin = truncation + 2 * cell;
    origin = low - Vec{margin, margin, margin};
    nx = int(std::ceil((high.x + margin - origin.x) * inverse)) + 1;
    ny = int(std::ceil((high.y + margin - origin.y) * inverse)) + 1;
    nz = int(std::ceil((high.z + margin - origin.z) * inverse)) + 1;
    splat(truncation, threads);
    if (has_origin) mark_occluded(depth_points, pixel, tolerance, threads);
}

void ScanField::splat(float truncation, int threads) {
    const int64_t size = int64_t(nx) * ny * nz;
    index.assign(size, -1);
    std::vector<float> nearest_squared(size, 1e30f);
    const int reach = int(truncation * inverse) + 1;
    // Each slab of cells is written by one thread, in the order of the points.
    constexpr int slab = 16;
    parallel_for((nx + slab - 1) / slab, threads, [&](int64_t part) {
        const int first = int(part) * slab, last = std::min(nx, first + slab) - 1;
        for (size_t s = 0; s < points.size(); ++s) {
            const Vec p = points[s].p;
            const int ci = int((p.x - origin.x) * inverse), cj = int((p.y - origin.y) * inverse),
                      ck = int((p.z - origin.z) * inverse);
            for (int i = std::max(first, ci - reach); i <= std::min(last, ci + reach); ++i) {
                const float dx = origin.x + (i + .5f) * cell - p.x, rest = truncation * truncation - dx * dx;
                if (rest < 0) continue;
                for (int j = std::max(0, cj - reach); j <= std::min(ny - 1, cj + reach); ++j) {
                    const float dy = origin.y + (j + .5f) * cell - p.y, left = rest - dy * dy;
                    if (left < 0) continue;
                    const int width = int(std::sqrt(left) * inverse) + 1;
                    const int64_t row = (int64_t(i) * ny + j) * nz;
                    for (int k = std::max(0, ck - width); k <= std::min(nz - 1, ck + width); ++k) {
                        const float dz = origin.z + (k + .5f) * cell - p.z, d = dx * dx + dy * dy + dz * dz;
                        if (d < nearest_squared[row + k]) nearest_squared[row + k] = d, index[row + k] = int(s);
                    }
                }
            }
        }
    });
}

void ScanField::mark_occluded(const std::vector<Vec> &depth_points, float pixel, float tolerance, int threads) {
    // A depth image from the sensor origin towards the cloud; its pixels are as wide as `pixel` at the mean range.
    double mean[3] = {0, 0, 0};
    for (const Vec &p : depth_points) mean[0] += p.x, mean[1] += p.y, mean[2] += p.z;
    const double n = double(std::max<size_t>(1, depth_points.size()));
    Vec forward = Vec{float(mean[0] / n), float(mean[1] / n), float(mean[2] / n)} - sensor;
    const float range = std::max(norm(forward), 1e-6f);
    forward = (1 / range) * forward;
    Vec right = cross(std::abs(forward.x) < .7f ? Vec{1, 0, 0} : Vec{0, 1, 0}, forward);
    right = (1 / norm(right)) * right;
    const Vec down = cross(forward, right);
    const float focal = range / pixel;
    auto project = [&](Vec p, float &u, float &v, float &z) {
        const Vec d = p - sensor;
        z = dot(d, forward);
        if (z <= 1e-6f) return false;
        u = focal * dot(d, right) / z, v = focal * dot(d, down) / z;
        return true;
    };
    float half_width = 0, half_height = 0, u, v, z;
    for (const Vec &p : depth_points)
        if (project(p, u, v, z)) half_width = std::max(half_width, std::abs(u)), half_height = std::max(half_height, std::abs(v));
    // Beyond two image widths a return says nothing about the object any more.
    const float widest = 4096;
    half_width = std::min(half_width, widest), half_height = std::min(half_height, widest);
    const int width = int(2 * half_width) + 8, height = int(2 * half_height) + 8;
    std::vector<float> depth(int64_t(width) * height, 1e30f);
    for (const Vec &p : depth_points) {
        if (!project(p, u, v, z)) continue;
        // A point covers the pixels that its half-pixel square touches: sparse clouds still cast whole shadows.
        for (float du = -.5f; du <= .5f; du += .5f)
            for (float dv = -.5f; dv <= .5f; dv += .5f) {
                const float x = u + du + width * .5f, y = v + dv + height * .5f;
                if (x < 0 || y < 0 || x >= width || y >= height) continue;
                float &d = depth[int64_t(y) * width + int64_t(x)];
                d = std::min(d, z);
            }
    }
    occluded.assign(int64_t(nx) * ny * nz, 0);
    parallel_for(nx, threads, [&](int64_t i) {
        float u, v, z;
        for (int j = 0; j < ny; ++j)
            for (int k = 0; k < nz; ++k) {
                const Vec p{origin.x + (i + .5f) * cell, origin.y + (j + .5f) * cell, origin.z + (k + .5f) * cell};
                if (!project(p, u, v, z)) continue;
                const float x = u + width * .5f, y = v + height * .5f;
                if (x < 0 || y < 0 || x >= width || y >= height) continue;
                if (z > depth[int64_t(y) * width + int64_t(x)] + tolerance)
                    occluded[(i * ny + j) * nz + k] = 1;
            }
    });
}

} // namespace pwr
