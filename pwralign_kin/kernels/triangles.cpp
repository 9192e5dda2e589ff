#include "triangles.hpp"

namespace pwr {

namespace {

constexpr int leaf_size = 4;
constexpr int most_depth = 64;

Vec least(Vec a, Vec b) { return {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)}; }
Vec greatest(Vec a, Vec b) { return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)}; }

Vec on_segment(Vec p, Vec a, Vec b) {
    const Vec along = b - a;
    const float length = dot(along, along);
    return length > 0 ? a + std::clamp(dot(p - a, along) / length, 0.f, 1.f) * along : a;
}

// The closest point is the foot on the plane where that lies inside, else it lies on an edge.
Vec on_triangle(Vec p, const Vec *corner) {
    const Vec normal = cross(corner[1] - corner[0], corner[2] - corner[0]);
    bool inside = dot(normal, normal) > 0;
    for (int i = 0; i < 3 && inside; ++i)
        inside = dot(cross(corner[(i + 1) % 3] - corner[i], p - corner[i]), normal) >= 0;
    if (inside) return p - (dot(p - corner[0], normal) / dot(normal, normal)) * normal;
    Vec best{};
    float nearest = INFINITY;
    for (int i = 0; i < 3; ++i) {
        const Vec at = on_segment(p, corner[i], corner[(i + 1) % 3]);
        const float squared = dot(p - at, p - at);
        if (squared < nearest) nearest = squared, best = at;
    }
    return best;
}

} // namespace

TriangleMesh::TriangleMesh(const Vec *vertices, const int *faces, int64_t count) {
    for (int64_t i = 0; i < count; ++i)
        triangles.push_back({{vertices[faces[3 * i]], vertices[faces[3 * i + 1]], vertices[faces[3 * i + 2]]}});
    if (count > 0) build(0, int(count));
}

void TriangleMesh::build(int first, int count) {
    Box box{{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}, -1, first, count};
    Vec low = box.low, high = box.high;
    for (int i = first; i < first + count; ++i) {
        for (const Vec &v : triangles[i].corner) box.low = least(box.low, v), box.high = greatest(box.high, v);
        low = least(low, triangles[i].middle()), high = greatest(high, triangles[i].middle());
    }
    const int here = int(boxes.size());
    boxes.push_back(box);
    if (count <= leaf_size) return;
    const Vec extent = high - low;
    const Vec axis = extent.x >= std::max(extent.y, extent.z) ? Vec{1, 0, 0} : extent.y >= extent.z ? Vec{0, 1, 0} : Vec{0, 0, 1};
    const int half = count / 2;
    std::nth_element(triangles.begin() + first, triangles.begin() + first + half, triangles.begin() + first + count,
                     [&](const Triangle &a, const Triangle &b) { return dot(a.middle(), axis) < dot(b.middle(), axis); });
    boxes[here].count = 0;
    build(first, half);
    boxes[here].second = int(boxes.size());
    build(first + half, count - half);
}

float TriangleMesh::squared_distance(Vec p, const Box &box) {
    const Vec outside = greatest(greatest(box.low - p, p - box.high), {0, 0, 0});
    return dot(outside, outside);
}

float TriangleMesh::closest(Vec p, float squared, Vec &at) const {
    if (boxes.empty() || squared_distance(p, boxes[0]) >= squared) return squared;
    struct Waiting {
        int box;
        float squared;
    } waiting[most_depth];
    int count = 0, box = 0;
    while (true) {
        const Box &here = boxes[box];
        for (int i = here.first; i < here.first + here.count; ++i) {
            const Vec found = on_triangle(p, triangles[i].corner);
            const float own = dot(p - found, p - found);
            if (own < squared) squared = own, at = found;
        }
        if (here.count == 0) {
            Waiting near{box + 1, squared_distance(p, boxes[box + 1])}, far{here.second, squared_distance(p, boxes[here.second])};
            if (far.squared < near.squared) std::swap(near, far);
            if (far.squared < squared) waiting[count++] = far;
            if (near.squared < squared) {
                box = near.box;
                continue;
            }
        }
        while (count > 0 && waiting[count - 1].squared >= squared) --count;
        if (count == 0) return squared;
        box = waiting[--count].box;
    }
}

} // namespace pwr
