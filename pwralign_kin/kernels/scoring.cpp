#include "closest_parts.hpp"
#include "sample_lanes.hpp"
#include "search.hpp"
#include <numeric>

namespace pwr {

namespace {

constexpr int samples_in_sight = 300; // of each part, at most
constexpr float grazing = .15f;       // cosine between normal and view below which a sensor hardly sees surface

} // namespace

Nearest::Nearest(int64_t count, float cap)
    : cap(cap), distance(count + lane_count, cap), part(count, -1), sample(count, -1) {}

void Search::offer(const BalledPoints &points, const Rigid *T, const uint8_t *mask, Nearest &to,
                   const uint8_t *balls) const {
    thread_local CloseSamples close;
    for (int p = 0; p < model.parts; ++p)
        if (mask[p])
            offer_part(model.surface[p], p, to_float(T[p]), points, balls, to.cap,
                       to.loosely ? model.surface[p].cell_slack : 0, to.distance.data(), to.part.data(),
                       to.sample.data(), close);
}

Assignment Search::assign(const BalledPoints &points, const Rigid *T, const uint8_t *mask, float cap) const {
    const size_t count = points.order.size();
    Nearest found(count, cap);
    offer(points, T, mask, found);
    Assignment a;
    a.distance.resize(count), a.part.resize(count), a.sample.resize(count);
    for (size_t at = 0; at < count; ++at) {
        const int i = points.order[at];
        a.distance[i] = found.distance[at], a.part[i] = found.part[at], a.sample[i] = found.sample[at];
    }
    return a;
}

Assignment Search::owners(const Rigid *T, const uint8_t *mask, float cap) const {
    Assignment in_sample = assign(sample_of_points(int(field.points.size())).balled, T, mask, cap), a = in_sample;
    for (size_t i = 0; i < shuffled.size(); ++i) {
        const int k = shuffled[i];
        a.distance[k] = in_sample.distance[i], a.part[k] = in_sample.part[i], a.sample[k] = in_sample.sample[i];
    }
    return a;
}

void Search::distances(const BalledPoints &points, const std::vector<Rigid> &T, int64_t count, const uint8_t *mask,
                       float cap, bool loosely, float *out) const {
    const size_t asked = points.order.size();
    parallel_for(count, options.threads, [&](int64_t c) {
        Nearest found(int64_t(asked), cap);
        found.loosely = loosely;
        offer(points, &T[c * model.parts], mask, found);
        for (size_t at = 0; at < asked; ++at) out[c * asked + points.order[at]] = found.distance[at];
    });
}

// Share of the scan points that the model explains, each by its distance and the agreement of its normal.
float Search::coverage(const PointSample &sample, const Nearest &nearest, const std::vector<RigidF> &T,
                       float distance) const {
    // Looked up in the order of the neighbourhood, for the memory's sake, and added in that of the sample.
    const std::vector<int> &order = sample.balled.order;
    std::vector<float> gained(order.size());
    for (size_t at = 0; at < order.size(); ++at)
        gained[order[at]] =
            gain(shuffled[order[at]], nearest.part[at], nearest.sample[at], nearest.distance[at], T, distance);
    return std::accumulate(gained.begin(), gained.end(), 0.f) / sample.weight;
}

// What a scan point adds to coverage, by the part and the sample nearest to it (-1: none) and their distance.
float Search::gain(int point, int part, int sample, float from_part, const std::vector<RigidF> &T,
                   float distance) const {
    const float weight = field.weight[point] * field.area[point], lost = options.normal_penalty;
    if (part < 0) return 0;
    if (from_part >= distance) return field.region[point] >= 0 ? -options.near_penalty * weight : 0.f;
    const Vec n = rotate(T[part], model.surface[part].apparent[sample]);
    const float share = from_part / distance;
    return weight * (1 - share * share) * (1 - lost + lost * std::abs(dot(n, field.points[point].n)));
}

// Support of a part by a scan from all sides: only points that no other part owns speak for it, or twins would
// collapse onto each other.
float Search::exclusive_support(int part, const RigidF &T, const std::vector<int> &owner, float distance) const {
    const Surface &s = model.surface[part];
    const int count = s.count(support_samples);
    const float limit = distance * distance;
    FloatLanes sum{};
    for_samples(field, s, T, 0, count, [&](const SampleLanes &at) {
        IntLanes holder{};
        for (int j = 0; j < lane_count; ++j) holder[j] = owner[at.nearest[j]];
        const FloatLanes match = (1 - at.squared / limit) * (.25f + .75f * at.facing);
        const FloatLanes contested = all_lanes(-options.free_penalty * options.contested_penalty);
        const FloatLanes near = (holder == part) | (holder < 0) ? match : contested;
        sum += at.w * (at.squared < limit ? near : all_lanes(-options.free_penalty));
    });
    return sum_of_lanes(sum) / s.cumulated[count];
}

// Evidence of a single view against a part, <= 0: surface in seen free space, or facing the sensor in front of the
// scan without matching it. A reward would favour poses that merely show more surface.
float Search::violation(int part, const RigidF &T, float distance) const {
    const Surface &s = model.surface[part];
    const int count = s.count(support_samples);
    const float limit = distance * distance;
    FloatLanes sum{};
    for_samples(field, s, T, 0, count, [&](const SampleLanes &at) {
        const VecLanes view = field.sensor - at.place;
        const FloatLanes match = (1 - at.squared / limit) * (.25f + .75f * at.facing);
        // The cosine between normal and view is above .15.
        const IntLanes shown = (at.seen > 0) & (at.seen * at.seen > .0225f * dot(view, view));
        const IntLanes tells = shown & ((dot(at.away, view) > 0) | (at.facing > .5f));
        const FloatLanes mismatch = tells ? options.mismatch_penalty * (1 - match) : FloatLanes{};
        sum += at.w * (at.squared < limit ? mismatch : at.free);
    });
    return -sum_of_lanes(sum) / s.cumulated[count];
}

Search::Sight Search::in_sight(const std::vector<Rigid> &T, float distance, float cosine) const {
    const float limit = distance * distance;
    Sight sight{std::vector<float>(model.parts), std::vector<float>(model.parts), std::vector<float>(model.parts)};
    for (int p = 0; p < model.parts; ++p) {
        const Surface &s = model.surface[p];
        if (!s.exists) continue;
        const RigidF F = to_float(T[p]);
        const int count = s.count(samples_in_sight);
        FloatLanes shown{}, near{}, confirmed{};
        for_samples(field, s, F, 0, count, [&](const SampleLanes &at) {
            const VecLanes view = field.sensor - at.place;
            const IntLanes faces =
                (at.seen > 0) & (at.seen * at.seen > grazing * grazing * dot(view, view)) & (at.free > 0);
            const FloatLanes w = !field.has_origin ? at.w : faces ? at.w : FloatLanes{};
            shown += w;
            near += at.squared < limit ? w : FloatLanes{};
            // Of either side: the point nearest to a thin plate's surface may be on its back.
            confirmed += (at.squared < limit) & (at.cosine * at.cosine > cosine * cosine) ? w : FloatLanes{};
        });
        sight.shown[p] = sum_of_lanes(shown) / s.cumulated[count];
        sight.near[p] = sum_of_lanes(near) / s.cumulated[count];
        sight.confirmed[p] = sum_of_lanes(confirmed) / s.cumulated[count];
    }
    return sight;
}

// Support of the parts in `mask`.
void Search::update_support(const std::vector<int> &owner, const std::vector<RigidF> &T, float coverage_distance,
                            const uint8_t *mask, float *support) const {
    const float distance = 1.2f * coverage_distance;
    for (int p = 0; p < model.parts; ++p)
        if (mask[p])
            support[p] = field.has_origin ? violation(p, T[p], distance) : exclusive_support(p, T[p], owner, distance);
}

float Search::total_score(float covered, const float *support) const {
    float total = 0;
    for (int p = 0; p < model.parts; ++p)
        if (model.surface[p].exists)
            total +=
                model.surface[p].weight * (field.has_origin ? support[p] : std::max(support[p], options.absent_floor));
    return covered * options.coverage_scale + (options.two_way ? options.support_weight * total : 0.f);
}

std::vector<Scores> Search::score(const std::vector<Configuration> &configurations, int points,
                                  const std::vector<float> &coverage_distances) const {
    const int n = model.parts;
    const size_t m = configurations.size();
    const PointSample &sampled = sample_of_points(points);
    std::vector<Scores> scores(coverage_distances.size(),
                               Scores{std::vector<float>(m), std::vector<float>(m), std::vector<float>(m * n, 0.f)});
    std::vector<uint8_t> mask(n);
    for (int p = 0; p < n; ++p) mask[p] = model.surface[p].exists;
    parallel_for(int64_t(m), options.threads, [&](int64_t c) {
        std::vector<Rigid> T(n);
        model.forward(configurations[c].base, configurations[c].values.data(), T.data());
        std::vector<RigidF> F;
        for (const Rigid &t : T) F.push_back(to_float(t));
        Nearest nearest(int64_t(sampled.points.size()), options.band);
        offer(sampled.balled, T.data(), mask.data(), nearest);
        std::vector<int> owner(field.points.size(), -1);
        for (size_t at = 0; at < nearest.part.size(); ++at)
            owner[shuffled[sampled.balled.order[at]]] = nearest.part[at];
        const float against = cost(configurations[c], F);
        for (size_t d = 0; d < scores.size(); ++d) {
            float *support = &scores[d].support[c * n];
            scores[d].coverage[c] = coverage(sampled, nearest, F, coverage_distances[d]);
            update_support(owner, F, coverage_distances[d], mask.data(), support);
            scores[d].total[c] = total_score(scores[d].coverage[c], support) - against;
        }
    });
    return scores;
}

const PointSample &Search::sample_of_points(int most) const {
    const size_t size = std::min<size_t>(most, field.points.size());
    const std::lock_guard<std::mutex> lock(sampling);
    const auto known = drawn.find(size);
    if (known != drawn.end()) return known->second;
    std::vector<OrientedPoint> sampled(size);
    for (size_t i = 0; i < size; ++i) sampled[i] = field.points[shuffled[i]];
    std::vector<int> order;
    order.reserve(size);
    for (const int k : field.curve)
        if (rank[k] < int(size)) order.push_back(rank[k]);
    PointSample &sample = drawn.try_emplace(size, std::move(sampled), std::move(order)).first->second;
    for (size_t i = 0; i < size; ++i) sample.weight += field.weight[shuffled[i]] * field.area[shuffled[i]];
    return sample;
}

float Search::gain_at(const BalledPoints &points, int at, const Nearest &nearest, const std::vector<RigidF> &F) const {
    return gain(shuffled[points.order[at]], nearest.part[at], nearest.sample[at], nearest.distance[at], F,
                options.coverage_distance);
}

Search::Look Search::look_at(const Configuration &c, const PointSample &sample,
                             const std::vector<uint8_t> &parts) const {
    const int count = int(sample.points.size());
    Look look{Nearest(count, options.band), std::vector<int>(field.points.size(), -1),
              std::vector<float>(model.parts, 0.f), std::vector<float>(count), 0};
    std::vector<Rigid> T(model.parts);
    std::vector<RigidF> F;
    model.forward(c.base, c.values.data(), T.data());
    for (const Rigid &t : T) F.push_back(to_float(t));
    offer(sample.balled, T.data(), parts.data(), look.nearest);
    for (int at = 0; at < count; ++at) {
        const int point = shuffled[sample.balled.order[at]];
        look.owner[point] = look.nearest.part[at];
        look.gains[at] = gain_at(sample.balled, at, look.nearest, F);
    }
    update_support(look.owner, F, options.coverage_distance, parts.data(), look.support.data());
    const float gained = std::accumulate(look.gains.begin(), look.gains.end(), 0.f);
    look.score = total_score(gained / sample.weight, look.support.data()) - cost(c, F);
    return look;
}

std::vector<Configuration> Search::sweep(const std::vector<Configuration> &from, const std::vector<SweepTask> &tasks,
                                         int keep, float behind) const {
    constexpr int few_points = 350, most_points = 1500;
    constexpr float rounding = 1e-4f;
    const int n = model.parts;
    const float most_support = field.has_origin ? 0.f : 1.f;
    std::vector<uint8_t> all_parts(n);
    for (int p = 0; p < n; ++p) all_parts[p] = model.surface[p].exists;
    const PointSample *samples[] = {&sample_of_points(few_points), &sample_of_points(most_points)};
    std::vector<Look> looks(2 * from.size());
    parallel_for(int64_t(looks.size()), options.threads,
                 [&](int64_t i) { looks[i] = look_at(from[i / 2], *samples[i % 2], all_parts); });
    std::vector<std::vector<Configuration>> found(tasks.size());
    parallel_for(int64_t(tasks.size()), options.threads, [&](int64_t t) {
        const SweepTask &task = tasks[t];
        const Configuration &c = from[task.configuration];
        auto part_on = [&](int joint) {
            int part = 1;
            while (model.actuated[part] != joint) ++part;
            return part;
        };
        const int child = part_on(task.joint);
        // With the base moving the first part on the joint stands still, and all that hangs rigidly on it.
        std::vector<uint8_t> hangs(n, 0), moves(n), stays(n);
        for (int p = 1; p < n; ++p)
            hangs[p] = hangs[model.parent[p]] || (task.base_moves ? p == child : model.actuated[p] == task.joint);
        std::vector<int> moving, above; // above: and the child itself
        for (int p = 0; p < n; ++p) {
            const bool is_moving = task.base_moves ? !hangs[p] : hangs[p];
            if (is_moving && p > 0) moving.push_back(p);
            if (p > 0 && model.below(child, p)) above.push_back(p);
            moves[p] = is_moving && model.surface[p].exists;
            stays[p] = !is_moving && model.surface[p].exists;
        }
        std::vector<Rigid> T(n);
        std::vector<RigidF> F(n);
        auto place = [&](const Configuration &at, const std::vector<int> &parts) {
            model.forward(at.base, at.values.data(), parts, T.data());
            F[0] = to_float(T[0]);
            for (const int p : parts) F[p] = to_float(T[p]);
        };
        place(c, above);
        const Rigid held = T[child];
        // Two joints take half of their values each: refinement finds the rest of the way.
        const int stride = task.with < 0 ? 1 : 2;
        const Sweep &sweep = sweeps[child], alone{{}, {}, {}, false};
        const Sweep &other = task.with < 0 ? alone : sweeps[part_on(task.with)];
        auto axis = [&](const Sweep &s) {
            const int size = std::max(1, (int(s.values.size()) + stride - 1) / stride);
            return GridAxis{size, std::min(2, size / 8), s.circular};
        };
        const GridAxis first = axis(sweep), second = axis(other);
        std::vector<Configuration> tried(first.size * second.size, {c.base, c.values, 0});
        for (int v = 0; v < int(tried.size()); ++v) {
            tried[v].values[task.joint] = sweep.values[stride * (v / second.size)];
            if (task.with >= 0) tried[v].values[task.with] = other.values[stride * (v % second.size)];
            if (!task.base_moves) continue;
            place(tried[v], above);
            tried[v].base = held * inverse(T[child]) * tried[v].base;
        }
        // Few points tell which values are worth a look with many.
        std::vector<int> modes(tried.size());
        std::iota(modes.begin(), modes.end(), 0);
        for (const int many : {0, 1}) {
            const Look &look = looks[2 * task.configuration + many];
            const BalledPoints &points = samples[many]->balled;
            const int count = int(points.order.size());
            model.forward(c.base, c.values.data(), T.data());
            for (int p = 0; p < n; ++p) F[p] = to_float(T[p]);
            // Without what moves, the points that it took are nearest to something else, if to anything.
            Nearest before = look.nearest;
            std::vector<float> gains = look.gains, support = look.support;
            std::vector<uint8_t> balls(points.radii.size(), 0);
            std::vector<int> taken;
            for (int at = 0; at < count; ++at)
                if (before.part[at] >= 0 && moves[before.part[at]]) {
                    before.distance[at] = before.cap, before.part[at] = before.sample[at] = -1;
                    balls[at / lane_count] = 1, taken.push_back(at);
                }
            offer(points, T.data(), stays.data(), before, balls.data());
            for (const int at : taken) gains[at] = gain_at(points, at, before, F);
            const float still = std::accumulate(gains.begin(), gains.end(), 0.f);
            // Ownership in the whole scan decides contested samples of parts that stand still.
            std::vector<int> owner = look.owner, changed;
            auto owner_at = [&](int at) -> int & { return owner[shuffled[points.order[at]]]; };
            for (const int at : taken) owner_at(at) = before.part[at];
            const float least = look.score - behind;
            std::vector<float> row(tried.size(), lowest_score);
            Nearest now = before;
            for (const int v : modes) {
                place(tried[v], moving);
                now = before;
                offer(points, T.data(), moves.data(), now);
                float gained = 0;
                changed.clear();
                for (int at = 0; at < count; ++at)
                    if (now.part[at] != before.part[at]) {
                        gained += gain_at(points, at, now, F) - gains[at];
                        owner_at(at) = now.part[at], changed.push_back(at);
                    }
                const float covered = (still + gained) / samples[many]->weight;
                for (int p = 0; p < n; ++p)
                    if (moves[p]) support[p] = most_support;
                // What falls behind however well the moved parts may be supported need not be known.
                if (total_score(covered, support.data()) + rounding > least) {
                    update_support(owner, F, options.coverage_distance, moves.data(), support.data());
                    tried[v].score = row[v] = total_score(covered, support.data()) - cost(tried[v], F);
                }
                for (const int at : changed) owner_at(at) = before.part[at];
            }
            modes = best_modes(row, many ? keep : 3 * keep, first, second, least);
        }
        for (int v : modes) found[t].push_back(tried[v]);
    });
    std::vector<Configuration> out;
    for (auto &f : found) out.insert(out.end(), f.begin(), f.end());
    return out;
}

} // namespace pwr
