#include "cells.hpp"
#include "ordering.hpp"
#include "sample_lanes.hpp"
#include "search.hpp"
#include <numeric>

namespace pwr {

// Weighted mean over samples [first, last) of their evidence: near the scan with a matching normal counts for, in free
// space against, in occluded space (almost) nothing. Surface that faces away from the sensor cannot be supported.
float Search::part_score(int part, const RigidF &T, int first, int last, float distance,
                         const float *point_weights) const {
    const Surface &s = model.surface[part];
    const float limit = distance * distance, share = 1 / limit;
    FloatLanes sum{};
    for_samples(field, s, T, first, last, [&](const SampleLanes &at) {
        const FloatLanes penalty = at.free * options.free_penalty + (1 - at.free) * options.occluded_penalty;
        if (!any_lane(at.found)) {
            sum += at.w * -penalty;
            return;
        }
        FloatLanes trust = all_lanes(1);
        if (point_weights)
            for (int j = 0; j < lane_count; ++j) trust[j] = point_weights[at.nearest[j]];
        const FloatLanes match = trust * (1 - at.squared * share) * (.25f + .75f * at.facing);
        const IntLanes seen = field.has_origin ? at.seen > 0 : at.seen == at.seen;
        sum += at.w * (at.squared < limit ? (seen ? match : FloatLanes{}) : -penalty);
    });
    return sum_of_lanes(sum);
}

std::vector<int> Search::distinct(const std::vector<Hypothesis> &hypotheses, int keep, float radius) const {
    constexpr int probes = 6;
    std::vector<int> kept, kept_of_part(model.parts, 0);
    std::vector<std::vector<Vec>> seen(hypotheses.size());
    for (size_t h = 0; h < hypotheses.size(); ++h) {
        const int part = hypotheses[h].part;
        if (kept_of_part[part] >= keep) continue;
        const RigidF T = to_float(hypotheses[h].T);
        const int count = model.surface[part].count(probes);
        std::vector<Vec> placed;
        for (int i = 0; i < count; ++i) placed.push_back(apply(T, model.surface[part].p[i]));
        bool is_new = true;
        for (int other : kept) {
            if (hypotheses[other].part != part) continue;
            float sum = 0;
            for (int i = 0; i < count; ++i) sum += norm(placed[i] - seen[other][i]);
            if (sum < radius * count) {
                is_new = false;
                break;
            }
        }
        if (!is_new) continue;
        seen[h] = std::move(placed);
        kept.push_back(int(h));
        ++kept_of_part[part];
    }
    return kept;
}

namespace {
std::vector<Hypothesis> select(const std::vector<Hypothesis> &hypotheses, const std::vector<int> &indices) {
    std::vector<Hypothesis> out;
    for (int i : indices) out.push_back(hypotheses[i]);
    return out;
}
} // namespace

// The pose that lays a model pair onto a scan pair, given the frames of both and their first points.
static Rigid aligning(const float *Rs, Vec scan_point, const float *Rm, Vec model_point) {
    Rigid T = Rigid::identity();
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j)
            T.R[3 * i + j] = Rs[3 * i] * Rm[3 * j] + Rs[3 * i + 1] * Rm[3 * j + 1] + Rs[3 * i + 2] * Rm[3 * j + 2];
    const float world[3] = {scan_point.x, scan_point.y, scan_point.z};
    for (int i = 0; i < 3; ++i)
        T.t[i] =
            world[i] - (T.R[3 * i] * model_point.x + T.R[3 * i + 1] * model_point.y + T.R[3 * i + 2] * model_point.z);
    return T;
}

// Score a candidate; most fail on the first few samples already, a third of those on half of them.
void Search::consider(int part, const Rigid &pose, const float *point_weights, Pool &pool) const {
    constexpr int fewest_samples = 8, first_samples = 16;
    constexpr float promising = .15f, most_of_sample = .9f;
    // How much less than the whole surface its first samples may promise: chance hardly makes more.
    constexpr float fewest_doubt = .5f, first_doubt = .3f;
    const Surface &s = model.surface[part];
    const float distance = 1.3f * options.support_distance;
    const int fewest = s.count(fewest_samples), first = s.count(first_samples), last = s.count(options.sweep_samples);
    const RigidF T = to_float(pose);
    float early = part_score(part, T, 0, fewest, distance, point_weights);
    if (early < (pool.bar - fewest_doubt) * s.cumulated[fewest]) return;
    const float hoped = early + most_of_sample * (s.cumulated[first] - s.cumulated[fewest]);
    if (hoped < promising * s.cumulated[first]) return;
    early += part_score(part, T, fewest, first, distance, point_weights);
    if (early < std::max(promising, pool.bar - first_doubt) * s.cumulated[first] || !prior.reachable(part, pose))
        return;
    pool.add({part, pose, (early + part_score(part, T, first, last, distance, point_weights)) / s.cumulated[last]});
}

void Search::Pool::add(const Hypothesis &candidate) {
    if (candidate.score <= bar) return;
    best.push_back(candidate);
    if (best.size() < 2 * size) return;
    sort_by_score(best, size);
    bar = best.back().score;
}

std::vector<Hypothesis> Search::best_of(Pool pool, int keep, const float *point_weights) const {
    const int refined = std::min(60, 6 * keep);
    sort_by_score(pool.best, Pool::size);
    std::vector<Hypothesis> candidates = select(pool.best, distinct(pool.best, refined, .02f));
    for (auto &h : candidates) refine_part(h, 5, point_weights);
    sort_by_score(candidates);
    return select(candidates, distinct(candidates, keep, .03f));
}

std::vector<Hypothesis> Search::hypotheses_of_part(int part, const std::vector<int> &points, int anchors, uint64_t seed,
                                                   int keep, const float *point_weights) const {
    constexpr int votes_of_pair = 8, partners = 12;
    const Surface &s = model.surface[part];
    const PairTable &table = s.pairs;
    Pool pool;
    if (table.pairs.empty() || points.empty()) return {};
    Random random(seed * 0x9E3779B97F4A7C15ull + uint64_t(part) + 1);
    const int count = int(points.size()), anchor_count = std::min(anchors, count);
    std::vector<int> order = points;
    for (int a = 0; a < count; ++a) std::swap(order[a], order[a + random.below(uint32_t(count - a))]);
    // Regions with fewer points than anchors make up for it with more partners.
    const int per_anchor = std::max(1, anchors * partners / std::max(1, anchor_count));
    std::vector<Vec> positions;
    for (int j : order) positions.push_back(field.points[j].p);
    const SplitPoints split(positions.data(), count, 1);
    const int blocks = (count + lane_count - 1) / lane_count;
    std::vector<int> near(per_anchor + lane_count);
    for (int a = 0; a < anchor_count; ++a) {
        const OrientedPoint &p = field.points[order[a]];
        // The points are in random order: the first in range, from anywhere on, are a fair sample of them.
        int found = 0, block = int(random.below(uint32_t(blocks)));
        for (int looked = 0; looked < blocks && found < per_anchor;
             ++looked, block = block + 1 < blocks ? block + 1 : 0) {
            const int i = block * lane_count;
            const VecLanes d = p.p - split.at(i);
            const FloatLanes squared = dot(d, d);
            for_lanes(first_lanes(count - i) & (squared > table.shortest * table.shortest) &
                          (squared < table.longest * table.longest),
                      [&](int j) { near[found++] = order[i + j]; });
        }
        for (int b = 0; b < per_anchor && b < found; ++b) {
            const OrientedPoint &q = field.points[near[b]];
            float Rs[9], Rm[9];
            if (!PairTable::pair_frame(p.n, q.p - p.p, Rs)) continue;
            const int feature = table.feature(p.p, p.n, q.p, q.n);
            const auto start =
                std::lower_bound(table.pairs.begin(), table.pairs.end(), PairTable::packed(feature, 0, 0));
            const auto end = std::lower_bound(start, table.pairs.end(), PairTable::packed(feature + 1, 0, 0));
            const int matches = int(end - start);
            for (int v = 0; v < std::min(matches, votes_of_pair); ++v) {
                const uint64_t pair = start[random.below(uint32_t(matches))];
                const int first = PairTable::first(pair), second = PairTable::second(pair);
                PairTable::pair_frame(s.n[first], s.p[second] - s.p[first], Rm);
                consider(part, aligning(Rs, p.p, Rm, s.p[first]), point_weights, pool);
            }
        }
    }
    return best_of(std::move(pool), keep, point_weights);
}

std::vector<Hypothesis> Search::correspondence_hypotheses(int part, const std::vector<Correspondence> &given,
                                                          uint64_t seed, int keep) const {
    constexpr int trials = 20000;
    constexpr float stretch = .02f, bend = .35f;
    const float shortest = model.surface[part].pairs.shortest;
    Pool pool;
    if (given.size() < 2) return {};
    std::vector<double> cumulated{0};
    for (const Correspondence &c : given) cumulated.push_back(cumulated.back() + c.weight);
    Random random(seed * 0x9E3779B97F4A7C15ull + uint64_t(part) + 1);
    auto drawn = [&]() -> const Correspondence & {
        const auto at = std::upper_bound(cumulated.begin(), cumulated.end(), random.uniform() * cumulated.back());
        return given[std::clamp<int64_t>(at - cumulated.begin() - 1, 0, int64_t(given.size()) - 1)];
    };
    for (int t = 0; t < trials; ++t) {
        const Correspondence &a = drawn(), &b = drawn();
        const Vec model_pair = b.source.p - a.source.p, scan_pair = b.target.p - a.target.p;
        // A true pair keeps its length and the angle of its normals.
        if (norm(model_pair) < shortest || std::abs(norm(model_pair) - norm(scan_pair)) > stretch) continue;
        if (std::abs(dot(a.source.n, b.source.n) - dot(a.target.n, b.target.n)) > bend) continue;
        float Rs[9], Rm[9];
        if (!PairTable::pair_frame(a.target.n, scan_pair, Rs) || !PairTable::pair_frame(a.source.n, model_pair, Rm))
            continue;
        consider(part, aligning(Rs, a.target.p, Rm, a.source.p), field_weights, pool);
    }
    return best_of(std::move(pool), keep, field_weights);
}

const float *Search::weights_or_none(const std::vector<float> &weights) {
    return std::all_of(weights.begin(), weights.end(), [](float w) { return w == 1; }) ? nullptr : weights.data();
}

std::vector<Hypothesis> Search::part_hypotheses(const std::vector<int> &parts,
                                                const std::vector<std::vector<int>> &points, int anchors, uint64_t seed,
                                                int keep, const std::vector<float> &point_weights) const {
    std::vector<std::vector<Hypothesis>> found(parts.size());
    const float *weights = weights_or_none(point_weights);
    parallel_for(int64_t(parts.size()), options.threads,
                 [&](int64_t i) { found[i] = hypotheses_of_part(parts[i], points[i], anchors, seed, keep, weights); });
    std::vector<Hypothesis> all;
    for (auto &f : found) all.insert(all.end(), f.begin(), f.end());
    return all;
}

void Search::refine_parts(std::vector<Hypothesis> &hypotheses, int iterations) const {
    parallel_for(int64_t(hypotheses.size()), options.threads,
                 [&](int64_t i) { refine_part(hypotheses[i], iterations, field_weights); });
}

// Point-to-plane ICP of one part against the field, samples of the model towards the scan.
void Search::refine_part(Hypothesis &h, int iterations, const float *point_weights) const {
    const Surface &s = model.surface[h.part];
    const int count = s.count(80);
    const float limit = 2 * options.support_distance * options.support_distance;
    for (int iteration = 0; iteration < iterations; ++iteration) {
        const RigidF T = to_float(h.T);
        const Vec centre{T.t[0], T.t[1], T.t[2]};
        NormalLanes pulls;
        for_samples(field, s, T, 0, count, [&](const SampleLanes &at) {
            const FloatLanes rest = 1 - at.squared / limit, share = at.w / s.cumulated[count];
            const IntLanes pulled = at.found & (at.facing >= .3f) & (rest > 0);
            if (!any_lane(pulled)) return;
            const FloatLanes w = pulled ? share * rest * rest * at.facing : FloatLanes{};
            const VecLanes arm = at.place - centre, pull = Vec{0, 0, 0} - at.away;
            pulls.add_planes(arm, at.normal, dot(pull, at.normal), w);
            pulls.add_points(arm, pull, .1f * w);
        });
        Normal normal;
        pulls.add_to(normal);
        normal.mirror();
        for (int i = 0; i < 3; ++i)
            normal.H[7 * i] += 1e-3 * options.support_distance * options.support_distance + 1e-9;
        for (int i = 3; i < 6; ++i) normal.H[7 * i] += 1e-3;
        if (!solve_spd(normal.H, normal.g, 6)) break;
        retract(h.T, normal.g, .3);
    }
    h.score = part_score(h.part, to_float(h.T), 0, s.count(160), options.support_distance, point_weights) /
              s.cumulated[s.count(160)];
}

} // namespace pwr
