#include "articulated.hpp"
#include <algorithm>

namespace pwr {

int PairTable::feature(Vec p, Vec n, Vec q, Vec m) const {
    const Vec d = q - p;
    const float length = std::max(norm(d), 1e-12f);
    auto bin = [](float cosine) { return int(std::acos(std::clamp(cosine, -1.f, 1.f)) * float(10 / M_PI)); };
    const int distance = std::min(int(length / distance_bin), distance_bins);
    return ((distance * angle_bins + bin(dot(n, d) / length)) * angle_bins + bin(dot(m, d) / length)) * angle_bins +
           bin(dot(n, m));
}

bool PairTable::pair_frame(Vec n, Vec direction, float *R) {
    Vec y = direction - dot(direction, n) * n;
    const float length = norm(y);
    if (length < 1e-3f * norm(direction)) return false;
    y = (1 / length) * y;
    const Vec z = cross(n, y);
    const float frame[9] = {n.x, y.x, z.x, n.y, y.y, z.y, n.z, y.z, z.z};
    std::copy(frame, frame + 9, R);
    return true;
}

void Articulated::finish(Surface &s) const {
    s.cumulated.assign(1, 0.f);
    for (float w : s.w) s.cumulated.push_back(s.cumulated.back() + w);
    s.lane_points = SplitPoints(s.p.data(), int64_t(s.p.size()), 1);
    s.lane_normals = SplitPoints(s.n.data(), int64_t(s.n.size()), 1);
    s.lane_weights = s.w;
    s.lane_weights.resize(s.w.size() + lane_count, 0.f);
    s.dense_rows = OrientedRows();
    for (const OrientedPoint &d : s.dense) s.dense_rows.push(d.p, d.n);
    if (!s.dense.empty()) {
        Vec least = s.dense[0].p, most = least;
        for (const OrientedPoint &d : s.dense) {
            least = {std::min(least.x, d.p.x), std::min(least.y, d.p.y), std::min(least.z, d.p.z)};
            most = {std::max(most.x, d.p.x), std::max(most.y, d.p.y), std::max(most.z, d.p.z)};
        }
        s.middle = .5f * (least + most), s.half = .5f * (most - least) + Vec{s.slack, s.slack, s.slack};
    }
    const int count = s.count(120);
    PairTable &table = s.pairs;
    table.shortest = std::min(.25f * s.size, .08f);
    table.longest = s.size;
    table.distance_bins = int(s.size / PairTable::distance_bin) + 1;
    table.pairs.reserve(size_t(count) * count);
    for (int a = 0; a < count; ++a)
        for (int b = 0; b < count; ++b) {
            float R[9];
            if (a == b || norm(s.p[b] - s.p[a]) <= table.shortest) continue;
            if (!PairTable::pair_frame(s.n[a], s.p[b] - s.p[a], R)) continue;
            table.pairs.push_back(PairTable::packed(table.feature(s.p[a], s.n[a], s.p[b], s.n[b]), a, b));
        }
    std::sort(table.pairs.begin(), table.pairs.end());
}

Rigid Articulated::joint_placement(int part, double value) const {
    const double motion = multiplier[part] * value + offset[part];
    Rigid M = Rigid::identity();
    if (prismatic[part])
        for (int i = 0; i < 3; ++i) M.t[i] = motion * axis[3 * part + i];
    else rotation_about(&axis[3 * part], motion, M.R);
    return placement[part] * M;
}

void Articulated::forward(const Rigid &base, const double *values, Rigid *T) const {
    T[0] = base;
    for (int i = 1; i < parts; ++i) T[i] = T[parent[i]] * joint_placement(i, values[actuated[i]]);
}

void Articulated::forward(const Rigid &base, const double *values, const std::vector<int> &some, Rigid *T) const {
    T[0] = base;
    for (const int i : some) T[i] = T[parent[i]] * joint_placement(i, values[actuated[i]]);
}

bool Articulated::actuated_by(int part, double motion, double beyond, double &value) const {
    const double low = lower[actuated[part]], high = upper[actuated[part]];
    double u = (motion - offset[part]) / multiplier[part];
    if (!prismatic[part]) {
        // Of all full turns the one nearest to the middle of the limits.
        const double period = 2 * M_PI / std::abs(multiplier[part]);
        u -= period * std::nearbyint((u - (low + high) / 2) / period);
    }
    value = std::min(std::max(u, low), high);
    return u > low - beyond && u < high + beyond;
}

namespace {
void turned(const double *R, const double *v, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = R[3 * i] * v[0] + R[3 * i + 1] * v[1] + R[3 * i + 2] * v[2];
}

// The angle about `axis` that brings the direction `source` nearest to `target`.
double angle_bringing(const double *axis, const double *source, const double *target) {
    const double crossed[3] = {source[1] * target[2] - source[2] * target[1],
                               source[2] * target[0] - source[0] * target[2],
                               source[0] * target[1] - source[1] * target[0]};
    return std::atan2(dot(crossed, axis), dot(target, source) - dot(axis, source) * dot(target, axis));
}
} // namespace

bool Articulated::close(const std::vector<int> &chain, const Rigid &above, const Rigid &below, const Tolerance &open,
                        double *values) const {
    Rigid motion = inverse(above * placement[chain.front()]) * below;
    bool fits = true;
    if (chain.size() == 2) {
        const Rigid &between = placement[chain[1]];
        const double *first = &axis[3 * chain[0]], *second = &axis[3 * chain[1]];
        double source[3], target[3];
        turned(between.R, second, source), turned(motion.R, second, target);
        const double angle = angle_bringing(first, source, target);
        fits = actuated_by(chain[0], angle, open.beyond, values[0]);
        Rigid turn = Rigid::identity();
        rotation_about(first, angle, turn.R);
        motion = inverse(turn * between) * motion;
    }
    // The rotation in terms of the quaternion (w, v) with c = v . axis: its angle about the axis is the arctangent of
    // 4 w c over 2 (w^2 - c^2), and that of what is left the arccosine of 2 (w^2 + c^2) - 1.
    const int last = chain.back();
    const double *R = motion.R, *a = &axis[3 * last], half[3] = {R[7] - R[5], R[2] - R[6], R[3] - R[1]};
    double kept[3];
    turned(R, a, kept);
    const double cosine = dot(kept, a), angle = std::atan2(dot(half, a), R[0] + R[4] + R[8] - cosine);
    double off = std::acos(std::min(std::max(cosine, -1.), 1.)), moved = angle;
    if (prismatic[last]) {
        moved = dot(motion.t, a), off = std::hypot(off, angle);
        for (int i = 0; i < 3; ++i) motion.t[i] -= moved * a[i];
    }
    fits &= actuated_by(last, moved, open.beyond, values[chain.size() - 1]);
    return fits && off < open.turn && dot(motion.t, motion.t) < open.slide * open.slide;
}

void Articulated::joint_twist(int part, const Rigid *T, const double *c, double *twist) const {
    const double *R = T[part].R, *a = &axis[3 * part];
    double world[3];
    for (int r = 0; r < 3; ++r)
        world[r] = multiplier[part] * (R[3 * r] * a[0] + R[3 * r + 1] * a[1] + R[3 * r + 2] * a[2]);
    if (prismatic[part]) {
        twist[0] = twist[1] = twist[2] = 0;
        std::copy(world, world + 3, twist + 3);
    } else {
        const double o[3] = {T[part].t[0] - c[0], T[part].t[1] - c[1], T[part].t[2] - c[2]};
        std::copy(world, world + 3, twist);
        twist[3] = o[1] * world[2] - o[2] * world[1];
        twist[4] = o[2] * world[0] - o[0] * world[2];
        twist[5] = o[0] * world[1] - o[1] * world[0];
    }
}

void Articulated::joint_twists(const Rigid *T, const double *c, double *twists) const {
    std::fill(twists, twists + 6, 0.);
    for (int i = 1; i < parts; ++i) joint_twist(i, T, c, twists + 6 * i);
}

void Articulated::compose(Normal *normal, const double *twists, double *H, double *g) const {
    const int size = 6 + joints;
    for (int p = parts - 1; p > 0; --p) { // normal[p] is complete here: all its descendants have been added
        const int column = 6 + actuated[p];
        const double *S = &twists[6 * p];
        double HS[6] = {};
        for (int i = 0; i < 6; ++i)
            for (int j = 0; j < 6; ++j) HS[i] += normal[p].H[6 * i + j] * S[j];
        for (int i = 0; i < 6; ++i) {
            g[column] += S[i] * normal[p].g[i];
            H[i * size + column] += HS[i], H[column * size + i] += HS[i];
        }
        for (int ancestor = p; ancestor > 0; ancestor = parent[ancestor]) {
            double value = 0;
            for (int i = 0; i < 6; ++i) value += twists[6 * ancestor + i] * HS[i];
            const int row = 6 + actuated[ancestor];
            H[row * size + column] += value;
            if (ancestor != p) H[column * size + row] += value;
        }
        Normal &above = normal[parent[p]];
        above.add(normal[p]);
    }
}

} // namespace pwr
