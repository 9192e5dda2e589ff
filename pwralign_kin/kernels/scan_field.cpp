#include "scan_field.hpp"
#include "ordering.hpp"
#include "parallel.hpp"
#include <algorithm>

namespace pwr {

// Two zeros between any two of ten bits.
static uint32_t spread_bits(uint32_t v) {
    v = (v | v << 16) & 0x030000FF;
    v = (v | v << 8) & 0x0300F00F;
    v = (v | v << 4) & 0x030C30C3;
    return (v | v << 2) & 0x09249249;
}

// The curve orders points by interleaved bits of their coordinates (G. M. Morton, 1966), in cells of 1/1024 of
// `extent`.
std::vector<int> along_curve(const Vec *points, int64_t stride, int64_t count, Vec low, float extent) {
    const float scale = 1023 / std::max(extent, 1e-6f);
    std::vector<uint64_t> keys(count);
    for (int64_t i = 0; i < count; ++i) {
        const Vec p = scale * (points[i * stride] - low);
        keys[i] = 4 * spread_bits(uint32_t(p.x)) + 2 * spread_bits(uint32_t(p.y)) + spread_bits(uint32_t(p.z));
    }
    return sort_keys(keys);
}

ScanField::ScanField(std::vector<Vec> positions, std::vector<Vec> normals, std::vector<float> weights,
                     std::vector<float> areas, std::vector<int> regions_of_points, float cell, float truncation,
                     const Vec *sensor_origin, const std::vector<Vec> &depth_points, const std::vector<Vec> &borders,
                     float pixel, float tolerance, float shadow, float unreturned, int threads)
    : weight(std::move(weights)), area(std::move(areas)), region(std::move(regions_of_points)),
      unreturned(sensor_origin ? unreturned : 1.f), has_origin(sensor_origin != nullptr),
      sensor(sensor_origin ? *sensor_origin : Vec{0, 0, 0}), cell(cell), inverse(1.f / cell) {
    Vec low{1e30f, 1e30f, 1e30f}, high{-1e30f, -1e30f, -1e30f};
    auto include = [&](Vec p) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
    };
    points.reserve(positions.size()), rows.reserve(positions.size());
    for (size_t i = 0; i < positions.size(); ++i) {
        points.push_back({positions[i], normals[i]});
        rows.push(positions[i], normals[i]);
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
    curve = along_curve(&points[0].p, 2, int64_t(points.size()), low,
                        std::max({high.x - low.x, high.y - low.y, high.z - low.z}));
    splat(truncation, threads);
    if (!has_origin) return;
    // Of what lies out of the picture a whole scene tells nothing: it is as if it were hidden right at the sensor.
    const bool whole_scene = unreturned < 1;
    const auto image = std::make_shared<const DepthImage>(depth_points, sensor, pixel, tolerance, whole_scene, borders);
    mark_unseen(*image, threads);
    if (whole_scene || !borders.empty()) beyond = image;
}

namespace {
const FloatLanes centres{.5f, 1.5f, 2.5f, 3.5f, 4.5f, 5.5f, 6.5f, 7.5f};
}

// Every layer of cells along x is filled on its own, by all points in order: a cell keeps the first of those nearest.
void ScanField::splat(float truncation, int threads) {
    if (int64_t(nx) * ny * nz >= std::numeric_limits<int>::max())
        throw std::invalid_argument("the points are too far apart for cells so small");
    outside = nx * ny * nz;
    cells.assign(size_t(outside) + 1, nothing);
    cells[outside] |= DepthImage::silent;
    const int reach = int(truncation * inverse) + 1;
    std::vector<std::vector<int>> of_layer(nx);
    for (size_t s = 0; s < points.size(); ++s) of_layer[int((points[s].p.x - origin.x) * inverse)].push_back(int(s));
    parallel_for(nx, threads, [&](int64_t i) {
        std::vector<int> near;
        for (int64_t layer = std::max<int64_t>(0, i - reach); layer <= std::min<int64_t>(nx - 1, i + reach); ++layer)
            near.insert(near.end(), of_layer[layer].begin(), of_layer[layer].end());
        if (near.empty()) return;
        // Written a few cells at a time, also past the end.
        std::vector<float> squared(int64_t(ny) * nz + lane_count, 1e30f);
        std::vector<int> codes(squared.size(), nothing);
        for (const int s : near) {
            const Vec p = points[s].p;
            const int cj = int((p.y - origin.y) * inverse), ck = int((p.z - origin.z) * inverse);
            const float dx = origin.x + (i + .5f) * cell - p.x, rest = truncation * truncation - dx * dx;
            if (rest < 0) continue;
            for (int j = std::max(0, cj - reach); j <= std::min(ny - 1, cj + reach); ++j) {
                const float dy = origin.y + (j + .5f) * cell - p.y, left = rest - dy * dy;
                if (left < 0) continue;
                const int width = int(std::sqrt(left) * inverse) + 1, last = std::min(nz - 1, ck + width);
                for (int k = std::max(0, ck - width); k <= last; k += lane_count) {
                    const int64_t at = int64_t(j) * nz + k;
                    const FloatLanes dz = origin.z + (centres + float(k)) * cell - p.z, d = dx * dx + dy * dy + dz * dz;
                    const FloatLanes before = load_lanes(&squared[at]);
                    const IntLanes code = load_lanes(&codes[at]), own = IntLanes{} + 4 * s;
                    const IntLanes nearer = first_lanes(last + 1 - k) & ((d < before) | ((d == before) & (own < code)));
                    store_lanes(nearer ? d : before, &squared[at]);
                    store_lanes(nearer ? own : code, &codes[at]);
                }
            }
        }
        std::copy(codes.begin(), codes.end() - lane_count, &cells[i * ny * nz]);
    });
}

namespace {
// Which pixels are in the picture: between two that are not empty, in their row or in their column.
std::vector<char> pictured(const std::vector<float> &depth, int width, int height, float empty) {
    std::vector<char> out(depth.size(), 0);
    auto fill = [&](int64_t first, int64_t step, int count) {
        int low = 0, high = count - 1;
        while (low < count && depth[first + low * step] >= empty) ++low;
        while (high > low && depth[first + high * step] >= empty) --high;
        for (int i = low; i <= high; ++i) out[first + i * step] = 1;
    };
    for (int y = 0; y < height; ++y) fill(int64_t(y) * width, 1, width);
    for (int x = 0; x < width; ++x) fill(x, width, height);
    return out;
}
} // namespace

DepthImage::DepthImage(const std::vector<Vec> &points, Vec sensor, float pixel, float tolerance, bool whole_scene,
                       const std::vector<Vec> &outward)
    : beside(whole_scene ? occluded : silent), tolerance(tolerance) {
    double mean[3] = {0, 0, 0};
    for (const Vec &p : points) mean[0] += p.x, mean[1] += p.y, mean[2] += p.z;
    const double n = double(std::max<size_t>(1, points.size()));
    forward = Vec{float(mean[0] / n), float(mean[1] / n), float(mean[2] / n)} - sensor;
    const float range = std::max(norm(forward), 1e-6f);
    forward = (1 / range) * forward;
    right = cross(std::abs(forward.x) < .7f ? Vec{1, 0, 0} : Vec{0, 1, 0}, forward);
    right = (1 / norm(right)) * right;
    down = cross(forward, right);
    for (const Vec &n : outward) borders.push_back({dot(n, right), dot(n, down), dot(n, forward)});
    focal = range / pixel;
    auto project = [&](Vec p, float &u, float &v, float &z) {
        const Vec d = p - sensor;
        z = dot(d, forward);
        if (z <= 1e-6f) return false;
        u = focal * dot(d, right) / z, v = focal * dot(d, down) / z;
        return true;
    };
    float half_width = 0, half_height = 0, u, v, z;
    for (const Vec &p : points)
        if (project(p, u, v, z))
            half_width = std::max(half_width, std::abs(u)), half_height = std::max(half_height, std::abs(v));
    // Beyond two image widths a return says nothing about the object any more.
    const float widest = 4096;
    half_width = std::min(half_width, widest), half_height = std::min(half_height, widest);
    width = int(2 * half_width) + 8, height = int(2 * half_height) + 8;
    depth.assign(int64_t(width) * height, silence);
    for (const Vec &p : points) {
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
    if (!whole_scene) return;
    const std::vector<char> in_picture = pictured(depth, width, height, silence);
    for (size_t at = 0; at < depth.size(); ++at)
        if (!in_picture[at]) depth[at] = 0;
}

void ScanField::mark_unseen(const DepthImage &image, int threads) {
    parallel_for(nx, threads, [&](int64_t i) {
        for (int j = 0; j < ny; ++j) {
            const Vec start = Vec{origin.x + (i + .5f) * cell, origin.y + (j + .5f) * cell, origin.z} - sensor;
            int *row = &cells[(i * ny + j) * nz];
            for (int k = 0; k < nz; k += lane_count) {
                const FloatLanes along = (centres + float(k)) * cell;
                const IntLanes state = image.states(dot(start, image.forward) + along * image.forward.z,
                                                    dot(start, image.right) + along * image.right.z,
                                                    dot(start, image.down) + along * image.down.z, first_lanes(nz - k));
                // One by one at the end of the row: what follows may be another thread's.
                if (k + lane_count <= nz) store_lanes(load_lanes(&row[k]) | state, &row[k]);
                else
                    for (int l = 0; l < nz - k; ++l) row[k + l] |= state[l];
            }
        }
    });
}

} // namespace pwr
