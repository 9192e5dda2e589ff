#include "surface_mixture.hpp"
#include "cells.hpp"
#include "parallel.hpp"

namespace pwr {

namespace {

constexpr float reach_sigmas = 3.6f; // patches farther from a point than this say nothing

// 2^x of eight numbers from -126 to 0, to a relative error below 3e-6 (minimax polynomial of the fraction).
FloatLanes power_of_two(FloatLanes x) {
    const IntLanes whole = __builtin_convertvector(x - .5f, IntLanes);   // truncated: x - .5 is negative
    const FloatLanes f = x - __builtin_convertvector(whole, FloatLanes); // in [-.5, .5]
    FloatLanes p = f * .00133335581f + .00961812911f;
    p = p * f + .0555041087f, p = p * f + .240226507f, p = p * f + .693147181f, p = p * f + 1.f;
    const IntLanes bits = (whole + 127) << 23;
    FloatLanes scale;
    std::memcpy(&scale, &bits, sizeof(scale));
    return p * scale;
}

// Inverse and determinant of a symmetric matrix xx xy xz yy yz zz.
float invert(const float *a, float *m) {
    const float c0 = a[3] * a[5] - a[4] * a[4], c1 = a[2] * a[4] - a[1] * a[5], c2 = a[1] * a[4] - a[2] * a[3];
    const float determinant = a[0] * c0 + a[1] * c1 + a[2] * c2, s = 1 / determinant;
    m[0] = s * c0, m[1] = s * c1, m[2] = s * c2;
    m[3] = s * (a[0] * a[5] - a[2] * a[2]), m[4] = s * (a[1] * a[2] - a[0] * a[4]),
    m[5] = s * (a[0] * a[3] - a[1] * a[1]);
    return determinant;
}

// R m R' of a symmetric matrix.
void turn(const float *R, const float *m, float *out) {
    const float full[9] = {m[0], m[1], m[2], m[1], m[3], m[4], m[2], m[4], m[5]};
    float half[9];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            half[3 * i + j] = R[3 * i] * full[j] + R[3 * i + 1] * full[3 + j] + R[3 * i + 2] * full[6 + j];
    int at = 0;
    for (int i = 0; i < 3; ++i)
        for (int j = i; j < 3; ++j)
            out[at++] = half[3 * i] * R[3 * j] + half[3 * i + 1] * R[3 * j + 1] + half[3 * i + 2] * R[3 * j + 2];
}

// Which of six ways a normal faces.
float facing(Vec n) {
    const Vec a{std::abs(n.x), std::abs(n.y), std::abs(n.z)};
    if (a.x >= a.y && a.x >= a.z) return n.x > 0 ? 0 : 1;
    if (a.y >= a.z) return n.y > 0 ? 2 : 3;
    return n.z > 0 ? 4 : 5;
}

// Patches placed in the scan, neighbours next to each other; fields may be read `lane_count` beyond the end.
struct PlacedPatches {
    SplitPoints mean;
    std::vector<float> M[6], height, trace; // inverse covariance with the noise, density at the mean, trace of M
    std::vector<int> part;
};

// Some of them that are looked at together, and what they are to one point.
struct Block {
    int64_t at;
    int count;
    FloatLanes density{};
    VecLanes force{};
    Block(int64_t at, int count) : at(at), count(count) {}
};

} // namespace

SurfaceMixture::SurfaceMixture(const Articulated &model, float spacing) : model(model), spacing(spacing) {
    double whole = 0;
    for (int p = 0; p < model.parts; ++p) {
        const Surface &s = model.surface[p];
        if (!s.exists) continue;
        const float each = s.area / s.dense.size(),
                    disc = each / (4 * float(M_PI)); // variance along a disc of that area
        // Samples that face different ways are kept apart by moving them to places far from each other.
        std::vector<Vec> apart;
        for (const OrientedPoint &d : s.dense) apart.push_back(d.p + Vec{2 * s.size * facing(d.n), 0, 0});
        const Cells cells(apart.data(), apart.size(), spacing);
        for (size_t from = 0, to; from < apart.size(); from = to) {
            double n = 0, sum[3] = {}, squares[6] = {};
            float flat[6] = {};
            Vec normal{0, 0, 0};
            const Vec first = s.dense[cells.order[from]].p;
            for (to = from; to < apart.size() && cells.keys[to] == cells.keys[from]; ++to) {
                const OrientedPoint &d = s.dense[cells.order[to]];
                const double x[3] = {d.p.x - first.x, d.p.y - first.y, d.p.z - first.z};
                const float m[3] = {d.n.x, d.n.y, d.n.z};
                for (int i = 0, at = 0; i < 3; ++i) {
                    sum[i] += x[i];
                    for (int j = i; j < 3; ++j, ++at) squares[at] += x[i] * x[j], flat[at] += (i == j) - m[i] * m[j];
                }
                normal = normal + d.n, ++n;
            }
            Patch patch{p,
                        float(n) * each,
                        0,
                        first + Vec{float(sum[0] / n), float(sum[1] / n), float(sum[2] / n)},
                        (1 / std::max(norm(normal), 1e-6f)) * normal,
                        {}};
            for (int i = 0, at = 0; i < 3; ++i)
                for (int j = i; j < 3; ++j, ++at)
                    patch.covariance[at] = float(squares[at] / n - sum[i] * sum[j] / (n * n) + disc * flat[at] / n);
            patches.push_back(patch), whole += patch.area;
        }
    }
    for (Patch &patch : patches) patch.weight = float(patch.area / whole);
}

void SurfaceMixture::look(const std::vector<Rigid> &T, const std::vector<Vec> &directions, float unseen) {
    constexpr float steepest = 4; // tangent of the slope up to which a surface may fall away between pixels
    std::vector<Vec> place, normal;
    for (const Patch &patch : patches) {
        const RigidF F = to_float(T[patch.part]);
        place.push_back(apply(F, patch.mean)), normal.push_back(rotate(F, patch.normal));
    }
    std::vector<double> seen(patches.size(), 0.);
    std::vector<float> u(patches.size()), v(patches.size()), depth(patches.size()), front;
    for (const Vec &towards : directions) {
        const Vec across = std::abs(towards.x) < .6f ? Vec{1, 0, 0} : Vec{0, 1, 0};
        Vec right = cross(towards, across);
        right = (1 / norm(right)) * right;
        const Vec down = cross(towards, right);
        // Pixels as wide as patches: with their neighbours they leave no gap that shows what is behind.
        float low_u = 1e30f, low_v = 1e30f, high_u = -1e30f, high_v = -1e30f;
        for (size_t j = 0; j < place.size(); ++j) {
            u[j] = dot(place[j], right) / spacing, v[j] = dot(place[j], down) / spacing,
            depth[j] = -dot(place[j], towards);
            low_u = std::min(low_u, u[j]), high_u = std::max(high_u, u[j]);
            low_v = std::min(low_v, v[j]), high_v = std::max(high_v, v[j]);
        }
        const int64_t width = int64_t(high_u - low_u) + 3, height = int64_t(high_v - low_v) + 3;
        front.assign(width * height, 1e30f);
        const auto pixel = [&](size_t j) { return (int64_t(v[j] - low_v) + 1) * width + int64_t(u[j] - low_u) + 1; };
        for (size_t j = 0; j < place.size(); ++j) {
            if (dot(normal[j], towards) <= 0) continue;
            const int64_t middle = pixel(j);
            for (int64_t row = -width; row <= width; row += width)
                for (int64_t column = -1; column <= 1; ++column) {
                    float &least = front[middle + row + column];
                    least = std::min(least, depth[j]);
                }
        }
        for (size_t j = 0; j < place.size(); ++j) {
            const float cosine = dot(normal[j], towards);
            if (cosine <= 0) continue;
            const float slope = std::min(steepest, std::sqrt(std::max(0.f, 1 - cosine * cosine)) / cosine);
            if (depth[j] <= front[pixel(j)] + spacing * (.5f + 2 * slope)) seen[j] += double(cosine) * patches[j].area;
        }
    }
    double all_seen = 0, whole = 0;
    for (size_t j = 0; j < seen.size(); ++j) all_seen += seen[j], whole += patches[j].area;
    if (all_seen == 0) return;
    for (size_t j = 0; j < seen.size(); ++j)
        patches[j].weight = float((1 - unseen) * seen[j] / all_seen + unseen * patches[j].area / whole);
}

MixtureEvidence SurfaceMixture::evidence(const std::vector<Vec> &points, const std::vector<Rigid> &T, const double *J,
                                         int n, float sigma, float strays, float volume, int threads) const {
    const int parts = model.parts, size = n + 1; // the last parameter is the noise
    const double stray_density = strays / volume;
    const float reach = reach_sigmas * sigma, squared_sigma = sigma * sigma;
    std::vector<RigidF> F;
    for (const Rigid &own : T) F.push_back(to_float(own));
    std::vector<Vec> means;
    for (const Patch &patch : patches) means.push_back(apply(F[patch.part], patch.mean));
    const Cells cells(means.data(), means.size(), reach);
    const size_t room = patches.size() + lane_count;
    PlacedPatches placed{{cells.sorted.data(), int64_t(cells.sorted.size()), 1}, {}, {}, {}, {}};
    for (auto &field : placed.M) field.assign(room, 0.f);
    placed.height.assign(room, 0.f), placed.trace.assign(room, 0.f), placed.part.assign(room, 0);
    for (size_t at = 0; at < patches.size(); ++at) {
        const Patch &patch = patches[cells.order[at]];
        float C[6], M[6], turned[6];
        std::copy(patch.covariance, patch.covariance + 6, C);
        C[0] += squared_sigma, C[3] += squared_sigma, C[5] += squared_sigma;
        const float determinant = invert(C, M);
        turn(F[patch.part].R, M, turned);
        for (int k = 0; k < 6; ++k) placed.M[k][at] = turned[k];
        placed.height[at] = (1 - strays) * patch.weight / (std::pow(2 * float(M_PI), 1.5f) * std::sqrt(determinant));
        placed.trace[at] = M[0] + M[3] + M[5], placed.part[at] = patch.part;
    }
    // Points of a cell look at the same patches.
    std::vector<std::pair<uint64_t, int>> asked;
    for (size_t i = 0; i < points.size(); ++i) asked.push_back({cells.key(points[i]), int(i)});
    std::sort(asked.begin(), asked.end());
    std::vector<int64_t> first;
    for (int64_t i = 0; i < int64_t(asked.size()); ++i)
        if (i == 0 || asked[i].first != asked[i - 1].first) first.push_back(i);
    first.push_back(asked.size());
    // Groups of a fixed size are added in their order, whichever thread makes them.
    constexpr int64_t group = 16;
    const int64_t groups = (int64_t(first.size()) - 1 + group - 1) / group;
    std::vector<MixtureEvidence> partial(groups);
    const Vec centre{F[0].t[0], F[0].t[1], F[0].t[2]};
    parallel_for(groups, threads, [&](int64_t b) {
        MixtureEvidence &own = partial[b];
        own.g.assign(size, 0.), own.H.assign(size * size, 0.), own.part_H.assign(36 * parts, 0.);
        std::vector<Block> blocks;
        std::vector<double> forces(3 * parts, 0.), shares(parts, 0.), score(size);
        std::vector<int> touched;
        for (int64_t c = b * group; c < std::min((b + 1) * group, int64_t(first.size()) - 1); ++c) {
            blocks.clear();
            cells.rows_about(points[asked[first[c]].second], 1, [&](int64_t from, int64_t to) {
                for (; from < to; from += lane_count)
                    blocks.emplace_back(from, int(std::min<int64_t>(lane_count, to - from)));
            });
            for (int64_t i = first[c]; i < first[c + 1]; ++i) {
                const Vec x = points[asked[i].second];
                FloatLanes sum{};
                for (Block &block : blocks) {
                    const VecLanes d = x - placed.mean.at(block.at);
                    const auto m = [&](int e) { return load_lanes(&placed.M[e][block.at]); };
                    const VecLanes f{m(0) * d.x + m(1) * d.y + m(2) * d.z, m(1) * d.x + m(3) * d.y + m(4) * d.z,
                                     m(2) * d.x + m(4) * d.y + m(5) * d.z};
                    const FloatLanes exponent = -.72134752f * dot(d, f); // 1 / (2 ln 2)
                    const IntLanes within = (exponent > -9.f) & first_lanes(block.count);
                    block.density = FloatLanes{};
                    if (!any_lane(within)) continue;
                    block.density = within ? load_lanes(&placed.height[block.at]) *
                                                 power_of_two(max_lanes(exponent, all_lanes(-20.f)))
                                           : FloatLanes{};
                    block.force = f;
                    sum += block.density;
                }
                const double total = double(sum_of_lanes(sum)) + stray_density;
                own.log_likelihood += std::log(total), own.strays += stray_density / total;
                const float least = float(1e-4 * total);
                double by_sigma = 0;
                for (const Block &block : blocks) {
                    if (!any_lane(block.density > least)) continue;
                    for (int j = 0; j < lane_count; ++j) {
                        if (block.density[j] <= least) continue;
                        const int p = placed.part[block.at + j];
                        const double r = block.density[j] / total;
                        const double f[3] = {block.force.x[j], block.force.y[j], block.force.z[j]};
                        if (shares[p] == 0) touched.push_back(p);
                        shares[p] += r;
                        for (int e = 0; e < 3; ++e) forces[3 * p + e] += r * f[e];
                        by_sigma +=
                            r * squared_sigma * (f[0] * f[0] + f[1] * f[1] + f[2] * f[2] - placed.trace[block.at + j]);
                    }
                }
                std::fill(score.begin(), score.end(), 0.);
                score[n] = by_sigma;
                const double arm[3] = {x.x - centre.x, x.y - centre.y, x.z - centre.z};
                for (const int p : touched) {
                    const double *f = &forces[3 * p];
                    const double wrench[6] = {arm[1] * f[2] - arm[2] * f[1],
                                              arm[2] * f[0] - arm[0] * f[2],
                                              arm[0] * f[1] - arm[1] * f[0],
                                              f[0],
                                              f[1],
                                              f[2]};
                    const double *own_J = J + int64_t(p) * 6 * n;
                    for (int e = 0; e < 6; ++e) {
                        for (int h = 0; h < 6; ++h) own.part_H[36 * p + 6 * e + h] += wrench[e] * wrench[h];
                        for (int a = 0; a < n; ++a) score[a] += own_J[e * n + a] * wrench[e];
                    }
                    shares[p] = 0;
                    std::fill(&forces[3 * p], &forces[3 * p] + 3, 0.);
                }
                touched.clear();
                for (int a = 0; a < size; ++a) {
                    if (score[a] == 0) continue;
                    own.g[a] += score[a];
                    for (int e = a; e < size; ++e) own.H[a * size + e] += score[a] * score[e];
                }
            }
        }
    });
    MixtureEvidence out;
    out.g.assign(size, 0.), out.H.assign(size * size, 0.), out.part_H.assign(36 * parts, 0.);
    const auto add = [](std::vector<double> &to, const std::vector<double> &from) {
        for (size_t k = 0; k < to.size(); ++k) to[k] += from[k];
    };
    for (const MixtureEvidence &own : partial) {
        out.log_likelihood += own.log_likelihood, out.strays += own.strays;
        add(out.g, own.g), add(out.H, own.H), add(out.part_H, own.part_H);
    }
    for (int a = 0; a < size; ++a)
        for (int e = 0; e < a; ++e) out.H[a * size + e] = out.H[e * size + a];
    return out;
}

} // namespace pwr
