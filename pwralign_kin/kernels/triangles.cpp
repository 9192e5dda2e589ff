#include "triangles.hpp"
#include "parallel.hpp"

namespace pwr {

namespace {

constexpr int most_waiting = 512; // more than the levels of any tree times the lanes

Vec least(Vec a, Vec b) { return {std::min(a.x, b.x), std::min(a.y, b.y), std::min(a.z, b.z)}; }
Vec greatest(Vec a, Vec b) { return {std::max(a.x, b.x), std::max(a.y, b.y), std::max(a.z, b.z)}; }

void set_lane(VecLanes &lanes, int lane, Vec v) { lanes.x[lane] = v.x, lanes.y[lane] = v.y, lanes.z[lane] = v.z; }

VecLanes along(const VecLanes &a, FloatLanes share, const VecLanes &b) {
    return {a.x + share * b.x, a.y + share * b.y, a.z + share * b.z};
}
VecLanes chosen(IntLanes condition, const VecLanes &a, const VecLanes &b) {
    return {condition ? a.x : b.x, condition ? a.y : b.y, condition ? a.z : b.z};
}

// The closest point of each triangle is the foot on its plane where that lies inside, else it lies on an edge.
VecLanes on_triangles(Vec p, const VecLanes *corner) {
    const FloatLanes nothing{};
    const VecLanes normal = cross(corner[1] - corner[0], corner[2] - corner[0]);
    const FloatLanes area = dot(normal, normal);
    IntLanes inside = area > 0;
    FloatLanes nearest = all_lanes(INFINITY);
    VecLanes best = corner[0];
    for (int i = 0; i < 3; ++i) {
        const VecLanes edge = corner[(i + 1) % 3] - corner[i], from = p - corner[i];
        inside &= dot(cross(edge, from), normal) >= 0;
        const FloatLanes length = dot(edge, edge), share = dot(from, edge) / (length > 0 ? length : all_lanes(1));
        const FloatLanes clamped = share > 1 ? all_lanes(1) : max_lanes(share, nothing);
        const VecLanes at = along(corner[i], clamped, edge), off = p - at;
        const FloatLanes squared = dot(off, off);
        best = chosen(squared < nearest, at, best), nearest = squared < nearest ? squared : nearest;
    }
    const FloatLanes height = dot(corner[0] - p, normal) / (inside ? area : all_lanes(1));
    return chosen(inside, {p.x + height * normal.x, p.y + height * normal.y, p.z + height * normal.z}, best);
}

} // namespace

TriangleMesh::TriangleMesh(const Vec *vertices, const int *faces, int64_t count) {
    std::vector<Triangle> triangles;
    for (int64_t i = 0; i < count; ++i)
        triangles.push_back({{vertices[faces[3 * i]], vertices[faces[3 * i + 1]], vertices[faces[3 * i + 2]]}});
    if (count == 0) return;
    Vec low = triangles[0].corner[0], high = low;
    for (const Triangle &triangle : triangles)
        for (const Vec &v : triangle.corner) low = least(low, v), high = greatest(high, v);
    middle = .5f * (low + high);
    for (const Triangle &triangle : triangles)
        for (const Vec &v : triangle.corner) radius = std::max(radius, norm(v - middle));
    build(triangles, 0, int(count));
}

// Halve the largest range of triangles until there is one for every lane; those that fit a leaf are whole.
int TriangleMesh::build(std::vector<Triangle> &triangles, int first, int count) {
    struct Range {
        int first, count;
    };
    std::vector<Range> ranges{{first, count}};
    while (int(ranges.size()) < lane_count) {
        const auto largest =
            std::max_element(ranges.begin(), ranges.end(), [](Range a, Range b) { return a.count < b.count; });
        const auto [from, size] = *largest;
        if (size <= lane_count) break;
        Vec low = triangles[from].middle(), high = low;
        for (int i = from; i < from + size; ++i)
            low = least(low, triangles[i].middle()), high = greatest(high, triangles[i].middle());
        const Vec extent = high - low;
        const Vec axis = extent.x >= std::max(extent.y, extent.z) ? Vec{1, 0, 0}
                         : extent.y >= extent.z                   ? Vec{0, 1, 0}
                                                                  : Vec{0, 0, 1};
        const int half = size / 2;
        std::nth_element(
            triangles.begin() + from, triangles.begin() + from + half, triangles.begin() + from + size,
            [&](const Triangle &a, const Triangle &b) { return dot(a.middle(), axis) < dot(b.middle(), axis); });
        *largest = {from, half};
        ranges.push_back({from + half, size - half});
    }
    const int here = int(nodes.size());
    Node node;
    node.low = node.high = {all_lanes(INFINITY), all_lanes(INFINITY), all_lanes(INFINITY)};
    nodes.push_back(node);
    for (int lane = 0; lane < int(ranges.size()); ++lane) {
        const Range own = ranges[lane];
        Vec low = triangles[own.first].corner[0], high = low;
        for (int i = own.first; i < own.first + own.count; ++i)
            for (const Vec &v : triangles[i].corner) low = least(low, v), high = greatest(high, v);
        set_lane(node.low, lane, low), set_lane(node.high, lane, high);
        if (own.count > lane_count) {
            node.inside[lane] = build(triangles, own.first, own.count);
            continue;
        }
        Leaf leaf;
        for (int j = 0; j < lane_count; ++j)
            for (int c = 0; c < 3; ++c)
                set_lane(leaf.corner[c], j, triangles[own.first + std::min(j, own.count - 1)].corner[c]);
        leaves.push_back(leaf);
        node.inside[lane] = -int(leaves.size());
    }
    nodes[here] = node;
    return here;
}

FloatLanes TriangleMesh::squared_distances(Vec p, const Node &node) {
    const VecLanes below = node.low - p, above = p - node.high;
    const FloatLanes nothing{};
    const VecLanes outside{max_lanes(max_lanes(below.x, above.x), nothing),
                           max_lanes(max_lanes(below.y, above.y), nothing),
                           max_lanes(max_lanes(below.z, above.z), nothing)};
    return dot(outside, outside);
}

float TriangleMesh::closest(Vec p, float squared, Vec &at) const {
    if (nodes.empty()) return squared;
    struct Waiting {
        int inside;
        float squared;
    } waiting[most_waiting];
    int count = 0;
    waiting[count++] = {0, 0};
    while (count > 0) {
        const Waiting next = waiting[--count];
        if (next.squared >= squared) continue;
        if (next.inside < 0) {
            const VecLanes found = on_triangles(p, leaves[-next.inside - 1].corner), off = p - found;
            const FloatLanes own = dot(off, off);
            for_lanes(own < squared, [&](int j) {
                if (own[j] < squared) squared = own[j], at = {found.x[j], found.y[j], found.z[j]};
            });
            continue;
        }
        const Node &node = nodes[next.inside];
        const FloatLanes far = squared_distances(p, node);
        // The nearest is looked at first: it comes last.
        const int before = count;
        for_lanes(far < squared, [&](int j) {
            int place = count++;
            for (; place > before && waiting[place - 1].squared < far[j]; --place) waiting[place] = waiting[place - 1];
            waiting[place] = {node.inside[j], far[j]};
        });
    }
    return squared;
}

namespace {

// Balls that hold placed meshes, side by side; those beyond the last hold nothing.
struct Balls {
    std::vector<VecLanes> middle;
    std::vector<FloatLanes> radius;

    Balls(const std::vector<const TriangleMesh *> &meshes, const std::vector<RigidF> &placed)
        : middle((meshes.size() + lane_count - 1) / lane_count), radius(middle.size(), all_lanes(-INFINITY)) {
        // A little larger, for the rounding of what is compared with them.
        for (size_t i = 0; i < meshes.size(); ++i) {
            set_lane(middle[i / lane_count], int(i % lane_count), apply(placed[i], meshes[i]->middle));
            radius[i / lane_count][i % lane_count] = meshes[i]->radius + 1e-5f;
        }
    }

    IntLanes reached(size_t group, Vec p, float distance) const {
        const VecLanes off = middle[group] - p;
        const FloatLanes within = radius[group] + distance;
        return (within > 0) & (dot(off, off) < within * within);
    }
};

} // namespace

void closest_on_meshes(const std::vector<const TriangleMesh *> &meshes, const std::vector<Rigid> &T, float reach,
                       int threads, std::vector<Vec> &points, std::vector<int> &owner) {
    std::vector<RigidF> into, placed;
    for (const Rigid &own : T) into.push_back(to_float(inverse(own))), placed.push_back(to_float(own));
    const Balls balls(meshes, placed);
    owner.assign(points.size(), -1);
    constexpr int64_t block = 128;
    const int64_t count = int64_t(points.size());
    parallel_for((count + block - 1) / block, threads, [&](int64_t b) {
        // What was closest to the point before bounds the distance from the start.
        int likely = -1;
        Vec before{0, 0, 0};
        for (int64_t k = b * block; k < std::min(count, (b + 1) * block); ++k) {
            const Vec p = points[k];
            float squared = reach * reach;
            auto offer = [&](int i, Vec local, float bound) {
                Vec at;
                const float own = meshes[i]->closest(local, bound, at);
                if (own < bound) squared = own, owner[k] = likely = i, before = at, points[k] = apply(placed[i], at);
            };
            const int first = likely;
            if (first >= 0) {
                const Vec local = apply(into[first], p), off = local - before;
                // A little more, so that rounding does not hide what is known to be there.
                const float far = dot(off, off), bound = far + 1e-5f * std::sqrt(far) + 1e-10f;
                offer(first, local, std::min(squared, bound));
            }
            for (size_t group = 0; group < balls.middle.size(); ++group)
                for_lanes(balls.reached(group, p, std::sqrt(squared)), [&](int lane) {
                    const int i = int(group) * lane_count + lane;
                    if (i != first) offer(i, apply(into[i], p), squared);
                });
        }
    });
}

} // namespace pwr
