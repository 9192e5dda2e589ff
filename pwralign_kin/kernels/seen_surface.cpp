#include "seen_surface.hpp"

namespace pwr {

SeenSurface::SeenSurface(const Articulated &model, const std::vector<RigidF> &T, Vec sensor) : sensor(sensor) {
    constexpr float layer = .01f;       // samples this much behind the foremost of their surroundings are seen too
    constexpr float most_pixels = 1e6f; // a sensor inside the model has no image
    constexpr float rim = 2;
    struct Facing {
        Vec p;
        Place place;
    };
    std::vector<Facing> facing;
    Vec middle{0, 0, 0};
    float spacing = 0;
    for (int part = 0; part < model.parts; ++part) {
        const Surface &s = model.surface[part];
        if (!s.exists) continue;
        spacing = std::max(spacing, s.slack);
        for (int i = 0; i < int(s.dense.size()); ++i) {
            const Vec p = apply(T[part], s.dense[i].p);
            if (dot(sensor - p, rotate(T[part], s.dense[i].n)) <= 0) continue;
            facing.push_back({p, {part, i}});
            middle = middle + p;
        }
    }
    if (facing.empty()) return;
    const Vec towards = (1.f / facing.size()) * middle - sensor;
    const float distance = norm(towards);
    if (distance == 0) return;
    forward = (1 / distance) * towards;
    const Vec across = std::abs(forward.x) < .6f ? Vec{1, 0, 0} : Vec{0, 1, 0};
    right = cross(forward, across), right = (1 / norm(right)) * right;
    down = cross(forward, right);
    // Pixels as wide as samples are apart: no gap in the front surface lets what is behind it show.
    pixels_per_tangent = distance / spacing;
    float low_u = 1e30f, low_v = 1e30f, high_u = -1e30f, high_v = -1e30f;
    for (const Facing &f : facing) {
        const Projected at = project(f.p);
        if (at.depth <= 0) continue;
        low_u = std::min(low_u, at.u), high_u = std::max(high_u, at.u);
        low_v = std::min(low_v, at.v), high_v = std::max(high_v, at.v);
    }
    corner_u = low_u - rim, corner_v = low_v - rim;
    const float wide = high_u - low_u + 2 * rim + 1, high = high_v - low_v + 2 * rim + 1;
    if (!(wide * high < most_pixels)) return;
    width = int(wide), height = int(high);
    pixels.resize(size_t(width) * height);
    for (const Facing &f : facing) {
        const Projected at = project(f.p);
        if (!inside(at)) continue;
        const int middle_pixel = pixel_at(at);
        for (int row = -width; row <= width; row += width)
            for (int column = -1; column <= 1; ++column) {
                float &front = pixels[middle_pixel + row + column].front;
                front = std::min(front, at.depth);
            }
    }
    for (const Facing &f : facing) {
        const Projected at = project(f.p);
        if (!inside(at)) continue;
        Pixel &pixel = pixels[pixel_at(at)];
        if (at.depth > pixel.front + layer) continue;
        const float u = at.u - std::floor(at.u) - .5f, v = at.v - std::floor(at.v) - .5f, off = u * u + v * v;
        if (off < pixel.off) pixel.off = off, pixel.place = f.place, pixel.u = at.u, pixel.v = at.v;
    }
}

SeenSurface::Projected SeenSurface::project(Vec p) const {
    const Vec way = p - sensor;
    const float depth = dot(way, forward), scale = depth > 0 ? pixels_per_tangent / depth : 0;
    return {dot(way, right) * scale - corner_u, dot(way, down) * scale - corner_v, depth};
}

SeenSurface::Place SeenSurface::on_ray_to(Vec p) const {
    constexpr float farthest = 1.5f; // pixels
    Place found{-1, -1};
    if (pixels.empty()) return found;
    const Projected at = project(p);
    if (!inside(at)) return found;
    const int middle_pixel = pixel_at(at);
    float best = farthest * farthest;
    for (int row = -width; row <= width; row += width)
        for (int column = -1; column <= 1; ++column) {
            const Pixel &pixel = pixels[middle_pixel + row + column];
            if (pixel.place.part < 0) continue;
            const float u = pixel.u - at.u, v = pixel.v - at.v, squared = u * u + v * v;
            if (squared < best) best = squared, found = pixel.place;
        }
    return found;
}

} // namespace pwr
