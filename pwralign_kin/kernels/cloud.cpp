#include "cloud.hpp"
#include "cells.hpp"
#include "lanes.hpp"
#include "parallel.hpp"
#include "scan_field.hpp"
#include <array>
#include <numeric>

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

std::vector<int> first_of_cells(const int *cell_of_point, const std::vector<int> &order, int cells, int each) {
    std::vector<int> chosen(int64_t(cells) * each, -1), found(cells, 0);
    for (const int point : order)
        if (int &own = found[cell_of_point[point]]; own < each)
            chosen[int64_t(cell_of_point[point]) * each + own++] = point;
    chosen.erase(std::remove(chosen.begin(), chosen.end(), -1), chosen.end());
    return chosen;
}

// The eigenvalues in ascending order, at least 0, of the symmetric matrix xx xy xz yy yz zz (O. K. Smith,
// Communications of the ACM 4, 1961).
static std::array<double, 3> eigenvalues(const double *m) {
    const double mean = (m[0] + m[3] + m[5]) / 3, a = m[0] - mean, b = m[3] - mean, c = m[5] - mean;
    const double xy = m[1], xz = m[2], yz = m[4];
    const double spread = std::sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6);
    const double determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz);
    const double cosine = std::clamp(determinant / std::max(2 * spread * spread * spread, 1e-300), -1., 1.);
    // They are mean + 2 spread c for the roots c of 4c^3 - 3c = cosine. One lies beyond cos(30 degrees), on the
    // cosine's side, where the slope is steep: Newton's method takes it from a parabola's guess to the last digits. The
    // others are what it leaves of the cubic.
    const double size = std::abs(cosine);
    double far = .8660254 + size * (.1640 - .0301 * size);
    for (int i = 0; i < 3; ++i) far -= ((4 * far * far - 3) * far - size) / (12 * far * far - 3);
    const double gap = std::sqrt(std::max(3 * (1 - far * far), 0.));
    const double low = cosine < 0 ? -far : (-far - gap) / 2, high = cosine < 0 ? (far + gap) / 2 : far;
    const double least = mean + 2 * spread * low, most = mean + 2 * spread * high, middle = 3 * mean - least - most;
    return {std::max(least, 0.), std::max(middle, 0.), std::max(most, 0.)};
}

// The unit eigenvector of such a matrix for its least eigenvalue: at right angles to all rows of what is left without
// it.
static Vec least_eigenvector(const double *m, double value) {
    const double rows[3][3] = {{m[0] - value, m[1], m[2]}, {m[1], m[3] - value, m[4]}, {m[2], m[4], m[5] - value}};
    double best[3] = {}, most = 0, longest = 0;
    for (int i = 0; i < 3; ++i) {
        const double *a = rows[i], *b = rows[(i + 1) % 3];
        const double c[3] = {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
        const double crossed = c[0] * c[0] + c[1] * c[1] + c[2] * c[2];
        if (crossed > most) most = crossed, std::copy(c, c + 3, best);
        longest = std::max(longest, a[0] * a[0] + a[1] * a[1] + a[2] * a[2]);
    }
    if (most > 1e-10 * longest * longest) {
        const double scale = 1 / std::sqrt(most);
        return {float(scale * best[0]), float(scale * best[1]), float(scale * best[2])};
    }
    // Points of one line: two eigenvalues are nearly the least, and rows nearly parallel.
    double A[3][3] = {{m[0], m[1], m[2]}, {m[1], m[3], m[4]}, {m[2], m[4], m[5]}}, values[3], V[3][3];
    eigen_symmetric(A, values, V);
    return {float(V[0][0]), float(V[1][0]), float(V[2][0])};
}

LocalPlanes local_planes(const Vec *points, int64_t count, float radius, int threads) {
    const Cells cells(points, count, radius);
    LocalPlanes out;
    out.normal.resize(count), out.mean.resize(count), out.variances.resize(count), out.neighbours.resize(count);
    const int64_t block = 256;
    const float limit = radius * radius;
    parallel_for((count + block - 1) / block, threads, [&](int64_t b) {
        Surroundings around;
        for (int64_t at = b * block; at < std::min(count, (b + 1) * block); ++at) {
            if (at == b * block || cells.keys[at] != cells.keys[at - 1]) around.look(cells, cells.sorted[at], 1);
            const int i = cells.order[at];
            FloatLanes sums[3] = {}, products[6] = {}, within{};
            for (int64_t j = 0; j < around.points.size; j += lane_count) {
                const VecLanes d = around.points.at(j) - points[i];
                const IntLanes near = first_lanes(int(around.points.size - j)) & (dot(d, d) <= limit);
                const FloatLanes v[3] = {near ? d.x : FloatLanes{}, near ? d.y : FloatLanes{},
                                         near ? d.z : FloatLanes{}};
                within += near ? all_lanes(1) : FloatLanes{};
                for (int a = 0, k = 0; a < 3; ++a) {
                    sums[a] += v[a];
                    for (int c = a; c < 3; ++c) products[k++] += v[a] * v[c];
                }
            }
            const int n = int(sum_of_lanes(within));
            double s[3], C[6];
            for (int a = 0; a < 3; ++a) s[a] = sum_of_lanes(sums[a]);
            for (int a = 0, k = 0; a < 3; ++a)
                for (int c = a; c < 3; ++c, ++k) C[k] = sum_of_lanes(products[k]) / double(n) - s[a] / n * s[c] / n;
            const auto [thin, wide, longest] = eigenvalues(C);
            out.normal[i] = least_eigenvector(C, thin);
            out.mean[i] = points[i] + Vec{float(s[0] / n), float(s[1] / n), float(s[2] / n)};
            out.variances[i] = {float(thin), float(wide), float(longest)};
            out.neighbours[i] = n;
        }
    });
    return out;
}

// `count` unit vectors: a spherical Fibonacci set, spread evenly over the sphere, the same for every cloud.
static std::vector<Vec> even_directions(int count) {
    std::vector<Vec> directions(count);
    for (int k = 0; k < count; ++k) {
        const float z = 1 - 2 * (k + .5f) / count, r = std::sqrt(1 - z * z), a = 2.39996323f * k;
        directions[k] = {r * std::cos(a), r * std::sin(a), z};
    }
    return directions;
}

// The plane of those of `around` that face a sensor in direction `view`, the first of them among them.
static Vec plane_seen(const std::vector<OrientedPoint> &around, Vec view) {
    int n = 0;
    double s[3] = {}, products[6] = {}, C[6];
    for (const OrientedPoint &o : around) {
        if (dot(o.n, view) <= 0) continue;
        const Vec d = o.p - around[0].p;
        const float v[3] = {d.x, d.y, d.z};
        ++n;
        for (int a = 0, k = 0; a < 3; ++a) {
            s[a] += v[a];
            for (int c = a; c < 3; ++c) products[k++] += double(v[a]) * v[c];
        }
    }
    for (int a = 0, k = 0; a < 3; ++a)
        for (int c = a; c < 3; ++c, ++k) C[k] = products[k] / n - s[a] / n * s[c] / n;
    const Vec plane = n < 4 ? around[0].n : least_eigenvector(C, eigenvalues(C)[0]);
    return dot(plane, around[0].n) < 0 ? -1.f * plane : plane;
}

std::vector<Vec> apparent_normals(const Vec *points, const Vec *normals, int64_t count, float radius, int threads) {
    constexpr float least_cosine = .25f; // at smaller ones hardly anything is seen
    const std::vector<Vec> views = even_directions(14);
    const Cells cells(points, count, radius);
    std::vector<Vec> apparent(count);
    const int64_t block = 256;
    parallel_for((count + block - 1) / block, threads, [&](int64_t b) {
        std::vector<OrientedPoint> around;
        for (int64_t i = b * block; i < std::min(count, (b + 1) * block); ++i) {
            around.assign(1, {points[i], normals[i]});
            cells.visit(points[i], radius, [&](int other, float) {
                if (other != i) around.push_back({points[other], normals[other]});
            });
            Vec sum = plane_seen(around, normals[i]);
            for (const Vec view : views)
                if (dot(view, normals[i]) > least_cosine) sum = sum + plane_seen(around, view);
            // Where all planes are at right angles to it, none says which way the surface faces.
            apparent[i] = norm(sum) > .1f ? (1 / norm(sum)) * sum : normals[i];
        }
    });
    return apparent;
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
    const std::vector<Vec> directions = even_directions(40);
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

namespace {

// The k nearest of the points that one query is shown, nearest first.
struct Nearest {
    explicit Nearest(int k) : squared(k), points(k) {}

    std::vector<float> squared;
    std::vector<int> points;
    int found = 0;

    bool complete() const { return found == int(points.size()); }
    void offer(int point, float at) {
        if (complete() && at >= squared.back()) return;
        int place = complete() ? found - 1 : found++;
        for (; place > 0 && squared[place - 1] > at; --place)
            squared[place] = squared[place - 1], points[place] = points[place - 1];
        squared[place] = at, points[place] = point;
    }
    // Look at some points, which `order` numbers (null: as they come).
    void search(const SplitPoints &shown, const int *order, Vec query, float reach) {
        found = 0;
        for (int64_t i = 0; i < shown.size; i += lane_count) {
            const VecLanes d = shown.at(i) - query;
            const FloatLanes at = dot(d, d);
            const IntLanes near = first_lanes(int(std::min<int64_t>(lane_count, shown.size - i))) &
                                  (at <= (complete() ? squared.back() : reach * reach));
            float squared_of[lane_count];
            store_lanes(at, squared_of);
            for_lanes(near, [&](int j) { offer(order ? order[i + j] : int(i + j), squared_of[j]); });
        }
    }
};

// About how far the k nearest of the points reach where they are dense: the lower quartile over a few queries, by at
// most so many of the points.
float usual_reach(const Vec *points, int64_t count, const Vec *queries, int64_t asked, int k) {
    constexpr int64_t most_points = 8000, most_queries = 16;
    const int64_t stride = (count + most_points - 1) / most_points, step = (asked + most_queries - 1) / most_queries;
    const SplitPoints some(points, count / stride, stride);
    // Points of a surface grow with the reach squared. A query may be one of the points.
    const int wanted = int(std::max<int64_t>(1, k / stride));
    const float share = std::sqrt(float(k) / (stride * wanted));
    Nearest nearest(wanted + 1);
    std::vector<float> reaches;
    for (int64_t q = 0; q < asked; q += step) {
        nearest.search(some, nullptr, queries[q], 1e18f);
        const float farthest = nearest.squared[nearest.found - 1];
        if (farthest > 0) reaches.push_back(share * std::sqrt(farthest));
    }
    if (reaches.empty()) reaches.push_back(0);
    const size_t rank = reaches.size() / 4;
    std::nth_element(reaches.begin(), reaches.begin() + rank, reaches.end());
    Vec low = points[0], high = points[0];
    for (int64_t i = 0; i < count; ++i) {
        low = {std::min(low.x, points[i].x), std::min(low.y, points[i].y), std::min(low.z, points[i].z)};
        high = {std::max(high.x, points[i].x), std::max(high.y, points[i].y), std::max(high.z, points[i].z)};
    }
    return std::max(1.8f * reaches[rank], 1e-5f + 4e-6f * norm(high - low)); // cells must be countable
}

} // namespace

Neighbours nearest_neighbours(const Vec *points, int64_t count, const Vec *queries, int64_t asked, int k, int threads) {
    Neighbours out;
    k = int(std::min<int64_t>(k, count));
    out.each = k;
    out.point.assign(asked * k, 0), out.distance.assign(asked * k, 0.f);
    if (k == 0) return out;
    constexpr int64_t block = 256;
    std::vector<int> left(asked);
    std::iota(left.begin(), left.end(), 0);
    // Those whose neighbours are too far for cells that suit the densest are asked again, among larger cells.
    for (float least_reach = 0; !left.empty() && std::isfinite(least_reach);) {
        std::vector<Vec> places;
        for (const int i : left) places.push_back(queries[i]);
        const Cells cells(points, count,
                          std::max(least_reach, usual_reach(points, count, places.data(), int64_t(places.size()), k)));
        least_reach = 4 * cells.size;
        // Queries of one cell follow one another and share their surroundings.
        std::vector<uint64_t> keys;
        for (const int i : left) keys.push_back(cells.key(queries[i]));
        const std::vector<int> order = sort_keys(keys);
        const int64_t asking = int64_t(order.size());
        std::vector<uint8_t> answered(asking, 1);
        parallel_for((asking + block - 1) / block, threads, [&](int64_t b) {
            Surroundings around[3]; // one, two and four cells far
            bool known[3] = {};
            Nearest best(k);
            for (int64_t at = b * block; at < std::min(asking, (b + 1) * block); ++at) {
                const int i = left[order[at]];
                if (at > b * block && keys[at] != keys[at - 1]) std::fill(known, known + 3, false);
                for (int wide = 0; wide < 3 && (wide == 0 || !best.complete()); ++wide) {
                    if (!known[wide]) around[wide].look(cells, queries[i], 1 << wide), known[wide] = true;
                    best.search(around[wide].points, around[wide].order.data(), queries[i],
                                float(1 << wide) * cells.size);
                }
                answered[at] = best.complete();
                for (int n = 0; n < k && best.complete(); ++n)
                    out.point[i * k + n] = best.points[n], out.distance[i * k + n] = std::sqrt(best.squared[n]);
            }
        });
        std::vector<int> unanswered;
        for (int64_t at = 0; at < asking; ++at)
            if (!answered[at]) unanswered.push_back(left[order[at]]);
        left.swap(unanswered);
    }
    return out;
}

std::vector<double> neighbourhood_variances(const Vec *points, int64_t count, const Vec *queries, int64_t asked,
                                            const std::vector<int> &sizes, int threads) {
    std::vector<double> out(3 * sizes.size() * asked);
    if (sizes.empty()) return out;
    const Neighbours near = nearest_neighbours(points, count, queries, asked, sizes.back(), threads);
    const int64_t block = 64;
    auto measure = [&](int64_t q) {
        double sums[3] = {}, products[6] = {};
        int k = 0;
        for (size_t s = 0; s < sizes.size(); ++s) {
            for (; k < std::min(sizes[s], near.each); ++k) {
                const Vec p = points[near.point[q * near.each + k]];
                const double d[3] = {double(p.x) - queries[q].x, double(p.y) - queries[q].y,
                                     double(p.z) - queries[q].z};
                for (int a = 0, i = 0; a < 3; ++a) {
                    sums[a] += d[a];
                    for (int b = a; b < 3; ++b, ++i) products[i] += d[a] * d[b];
                }
            }
            double scatter[6];
            for (int a = 0, i = 0; a < 3; ++a)
                for (int b = a; b < 3; ++b, ++i) scatter[i] = (products[i] - sums[a] * sums[b] / k) / (k - 3);
            const auto variances = eigenvalues(scatter);
            for (int a = 0; a < 3; ++a) out[(3 * s + a) * asked + q] = variances[a];
        }
    };
    parallel_for((asked + block - 1) / block, threads, [&](int64_t b) {
        for (int64_t q = b * block; q < std::min(asked, (b + 1) * block); ++q) measure(q);
    });
    return out;
}

std::vector<int64_t> first_occurrences(const double *rows, int64_t count) {
    // A table of the rows by a hash of their bits (multiply and shift, after the finaliser of SplitMix64).
    uint64_t size = 16;
    while (size < 2 * uint64_t(count)) size *= 2;
    std::vector<int64_t> table(size, -1), first;
    first.reserve(count);
    for (int64_t i = 0; i < count; ++i) {
        const double *row = rows + 3 * i;
        uint64_t hash = 0;
        for (int c = 0; c < 3; ++c) {
            const double value = row[c] + 0.; // makes -0 equal to 0 in its bits
            uint64_t bits;
            std::memcpy(&bits, &value, sizeof bits);
            hash = (hash ^ hash >> 29) + bits;
            hash *= 0x9E3779B97F4A7C15;
        }
        uint64_t at = (hash ^ hash >> 32) & (size - 1);
        while (table[at] >= 0 && !std::equal(row, row + 3, rows + 3 * table[at])) at = (at + 1) & (size - 1);
        if (table[at] < 0) table[at] = i, first.push_back(i);
    }
    return first;
}

std::vector<Vec> steps_around(const Vec *points, const Vec *normals, int64_t count, double step, int directions) {
    std::vector<double> cosines, sines;
    for (int k = 0; k < directions; ++k) {
        const double angle = 2 * M_PI * k / directions;
        cosines.push_back(step * std::cos(angle)), sines.push_back(step * std::sin(angle));
    }
    std::vector<Vec> ends;
    ends.reserve(count * directions);
    for (int64_t i = 0; i < count; ++i) {
        const Vec n = normals[i];
        // At right angles to the normal and to the axis that is least along it, and to both.
        const float x = std::abs(n.x), y = std::abs(n.y), z = std::abs(n.z);
        Vec first = cross(n, x <= y && x <= z ? Vec{1, 0, 0} : y <= z ? Vec{0, 1, 0} : Vec{0, 0, 1});
        first = (1 / norm(first)) * first;
        const Vec second = cross(n, first);
        for (int k = 0; k < directions; ++k)
            ends.push_back(points[i] + float(cosines[k]) * first + float(sines[k]) * second);
    }
    return ends;
}

Plane dominant_plane(const Vec *points, const Vec *normals, int64_t count, float tolerance, int trials, uint64_t seed) {
    Plane best{{0, 0, 0}, 0, 0};
    if (count == 0) return best;
    const SplitPoints split(points, count, 1), split_normals(normals, count, 1);
    Random random(seed);
    for (int t = 0; t < trials; ++t) {
        const uint32_t i = random.below(uint32_t(count));
        const Vec n = normals[i];
        const float offset = dot(n, points[i]);
        IntLanes inliers{};
        for (int64_t j = 0; j < count; j += lane_count) {
            const FloatLanes height = dot(n, split.at(j)) - offset, facing = dot(n, split_normals.at(j));
            inliers -= (abs_lanes(height) < tolerance) & (abs_lanes(facing) > .8f); // zero normals pad the last lanes
        }
        int64_t total = 0;
        for (int j = 0; j < lane_count; ++j) total += inliers[j];
        if (total > best.inliers) best = {n, offset, total};
    }
    return best;
}

} // namespace pwr
