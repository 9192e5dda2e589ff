#include "sample_lanes.hpp"
#include "search.hpp"
#include <numeric>
#include <optional>

namespace pwr {

void Search::refine(std::vector<Configuration> &configurations, int points, int iterations, float sigma_first,
                    float sigma_last, float support_weight, const std::vector<float> &part_weights) const {
    const PointSample &sampled = sample_of_points(points);
    parallel_for(int64_t(configurations.size()), options.threads, [&](int64_t c) {
        refine_one(configurations[c], sampled, iterations, sigma_first, sigma_last, support_weight,
                   &part_weights[c * model.parts]);
    });
}

// Add scan points that are pulled by the nearest part, each of weight `share`: point to plane, Geman-McClure kernel of
// scale `sigma`. With the surface `seen` those whose rays meet it are pulled by what they meet. `loosely`, points that
// may be off the closest sample by the size of a cell are not beyond an edge. `seen` and `counts` may be null.
void Search::pull_to_model(const PointSample &sample, float share, const std::vector<Rigid> &T, float sigma, float cap,
                           const SeenSurface *seen, std::vector<Normal> &normal, int *counts, bool loosely) const {
    const int n = model.parts;
    const float squared = sigma * sigma;
    // Without a sensor origin the sign of a scan normal is a guess, and its pairs keep some weight.
    const float doubtful = field.has_origin ? 0.f : .1f;
    std::vector<uint8_t> mask(n);
    std::vector<RigidF> F(n);
    for (int p = 0; p < n; ++p) mask[p] = model.surface[p].exists, F[p] = to_float(T[p]);
    const Vec centre{F[0].t[0], F[0].t[1], F[0].t[2]};
    const int count = int(sample.points.size());
    Nearest found(count, cap);
    offer(sample.balled, T.data(), mask.data(), found);
    if (seen)
        for (int at = 0; at < count; ++at) {
            const OrientedPoint &q = sample.points[sample.balled.order[at]];
            const SeenSurface::Place met = seen->on_ray_to(q.p);
            if (met.part < 0) continue;
            found.part[at] = -1;
            const OrientedPoint &s = model.surface[met.part].dense[met.sample];
            const Vec surface_normal = rotate(F[met.part], s.n), foot = apply(F[met.part], s.p);
            const float residual = dot(q.p - foot, surface_normal);
            if (std::abs(residual) > cap) continue;
            if (counts) ++counts[met.part];
            const float kernel = squared / (squared + residual * residual);
            normal[met.part].add_plane(foot - centre, surface_normal, residual, kernel * kernel * share);
        }
    // The points of each part one after the other, and as many more that count nothing.
    std::vector<int> first(n + 1, 0);
    for (const int p : found.part)
        if (p >= 0) ++first[p + 1];
    std::partial_sum(first.begin(), first.end(), first.begin());
    std::vector<int> of_part(first[n] + lane_count, 0), next(first.begin(), first.end() - 1);
    for (int at = 0; at < count; ++at)
        if (found.part[at] >= 0) of_part[next[found.part[at]]++] = at;
    for (int p = 0; p < n; ++p) {
        const Surface &surface = model.surface[p];
        const float rim = surface.slack + (loosely ? surface.cell_slack : 0);
        if (counts) counts[p] += first[p + 1] - first[p];
        NormalLanes pulls;
        for (int i = first[p]; i < first[p + 1]; i += lane_count) {
            const int here = std::min(lane_count, first[p + 1] - i);
            int samples[lane_count] = {};
            FloatLanes distance{};
            for (int j = 0; j < here; ++j)
                samples[j] = found.sample[of_part[i + j]], distance[j] = found.distance[of_part[i + j]];
            VecLanes place, scan_normal, foot, surface_normal;
            sample.rows.gather(&of_part[i], place, scan_normal);
            surface.dense_rows.gather(samples, foot, surface_normal);
            foot = apply(F[p], foot), surface_normal = rotate(F[p], surface_normal);
            const VecLanes offset = place - foot, arm = foot - centre;
            const FloatLanes residual = dot(offset, surface_normal), kernel = squared / (squared + distance * distance);
            // A point that faces away from the surface lies on another one, such as the other face of a panel.
            const FloatLanes agreement = max_lanes(dot(surface_normal, scan_normal), FloatLanes{});
            const FloatLanes trusted = kernel * kernel * (doubtful + (1 - doubtful) * agreement) * share;
            const FloatLanes w = first_lanes(here) ? trusted : FloatLanes{};
            pulls.add_planes(arm, surface_normal, residual, w);
            // Beyond an edge of the surface the distance has a part along the surface too: edges hold what planes let
            // slide.
            const VecLanes along = offset - residual * surface_normal;
            const FloatLanes length = sqrt_lanes(dot(along, along)), aside = length - rim;
            const IntLanes beyond = (aside > 0) & (w > 0);
            if (any_lane(beyond))
                pulls.add_planes(arm, (1 / (beyond ? length : all_lanes(1))) * along, aside, beyond ? w : FloatLanes{});
        }
        if (first[p] < first[p + 1]) pulls.add_to(normal[p]);
    }
}

// Add model samples that are pulled by the scan.
void Search::pull_to_scan(const std::vector<Rigid> &T, float sigma, float support_weight, const float *part_weights,
                          std::vector<Normal> &normal) const {
    const Vec centre{float(T[0].t[0]), float(T[0].t[1]), float(T[0].t[2])};
    const float reach = 2.25f * sigma * sigma + 1e-5f;
    for (int p = 0; p < model.parts; ++p) {
        const Surface &s = model.surface[p];
        if (!s.exists || part_weights[p] <= 0) continue;
        const RigidF F = to_float(T[p]);
        const int count = s.count(48);
        const float share = support_weight * part_weights[p] / s.cumulated[count];
        NormalLanes pulls;
        for_samples(field, s, F, 0, count, [&](const SampleLanes &at) {
            IntLanes pulled = at.found & (at.w > 0) & (at.facing >= .2f);
            if (field.has_origin) pulled &= at.seen > 0;
            if (!any_lane(pulled)) return;
            const FloatLanes kernel = reach / (reach + at.squared);
            const FloatLanes w = pulled ? share * at.w * at.facing * kernel * kernel : FloatLanes{};
            const VecLanes arm = at.place - centre, pull = Vec{0, 0, 0} - at.away;
            pulls.add_planes(arm, at.normal, dot(pull, at.normal), w);
            pulls.add_points(arm, pull, .05f * w);
        });
        pulls.add_to(normal[p]);
    }
}

std::vector<Normal> Search::normal_equations(const std::vector<OrientedPoint> &sampled, const std::vector<Rigid> &T,
                                             float sigma, float cap, float support_weight, const float *part_weights,
                                             bool along_rays, std::vector<int> &counts) const {
    // Pieces of a fixed size are added in their order, whichever thread makes them.
    constexpr int64_t piece = 1024;
    const int64_t count = int64_t(sampled.size()), pieces = (count + piece - 1) / piece;
    const int n = model.parts;
    std::vector<Normal> partial(pieces * n), normal(n);
    std::vector<int> counted(pieces * n, 0);
    std::optional<SeenSurface> seen;
    if (along_rays && field.has_origin) {
        std::vector<RigidF> F(n);
        for (int p = 0; p < n; ++p) F[p] = to_float(T[p]);
        seen.emplace(model, F, field.sensor);
    }
    parallel_for(pieces, options.threads, [&](int64_t b) {
        std::vector<Normal> own(n);
        const auto from = sampled.begin() + b * piece;
        const std::vector<OrientedPoint> points(from, from + std::min(piece, count - b * piece));
        std::vector<int> order(points.size());
        std::iota(order.begin(), order.end(), 0);
        pull_to_model({points, std::move(order)}, 1.f / count, T, sigma, cap, seen ? &*seen : nullptr, own,
                      &counted[b * n], true);
        std::copy(own.begin(), own.end(), partial.begin() + b * n);
    });
    counts.assign(n, 0);
    for (int64_t b = 0; b < pieces; ++b)
        for (int p = 0; p < n; ++p) normal[p].add(partial[b * n + p]), counts[p] += counted[b * n + p];
    if (support_weight > 0) pull_to_scan(T, sigma, support_weight, part_weights, normal);
    for (Normal &part : normal) part.mirror();
    return normal;
}

// Gauss-Newton with a Geman-McClure kernel whose scale shrinks geometrically. Scan points pull the nearest part, model
// samples are pulled by the scan. Per part the residuals are reduced to twist space; the joints enter by composite
// normal equations (`Articulated::compose`).
void Search::refine_one(Configuration &c, const PointSample &sampled, int iterations, float sigma_first,
                        float sigma_last, float support_weight, const float *part_weights) const {
    const int n = model.parts, joints = model.joints, size = 6 + joints;
    std::vector<Rigid> T(n);
    std::vector<Normal> normal(n);
    std::vector<double> twists(6 * n), H(size * size), step(size);
    for (int iteration = 0; iteration < iterations; ++iteration) {
        const float progress = std::min(1.f, iteration / (iterations * .7f));
        const float sigma = sigma_first * std::pow(sigma_last / sigma_first, progress);
        model.forward(c.base, c.values.data(), T.data());
        std::fill(normal.begin(), normal.end(), Normal());
        pull_to_model(sampled, 1.f / sampled.points.size(), T, sigma, 3 * sigma + .005f, nullptr, normal, nullptr,
                      false);
        if (support_weight > 0) pull_to_scan(T, sigma, support_weight, part_weights, normal);
        for (Normal &part : normal) part.mirror();
        model.joint_twists(T.data(), T[0].t, twists.data());
        // Neighbouring points share the sensor's error: a scan is worth about this many independent ones.
        constexpr double independent_points = 1000;
        const double belief = sigma * sigma / independent_points;
        std::fill(H.begin(), H.end(), 0.), std::fill(step.begin(), step.end(), 0.);
        model.compose(normal.data(), twists.data(), H.data(), step.data());
        prior.base.add(c.base, belief, normal[0].H, normal[0].g);
        for (size_t j = 0; j < prior.inverse_deviations.size(); ++j) {
            const double share = belief * prior.inverse_deviations[j] * prior.inverse_deviations[j];
            H[(6 + j) * (size + 1)] += share, step[6 + j] += share * (prior.values[j] - c.values[j]);
        }
        for (int i = 0; i < 6; ++i) {
            step[i] += normal[0].g[i];
            for (int j = 0; j < 6; ++j) H[i * size + j] += normal[0].H[6 * i + j];
            H[i * size + i] += i < 3 ? 2e-5 : 2e-4;
        }
        for (int j = 6; j < size; ++j) H[j * size + j] = 1.01 * H[j * size + j] + 2e-6;
        if (!solve_spd(H.data(), step.data(), size)) break;
        double largest = 0;
        for (int j = 0; j < joints; ++j)
            largest = std::max(largest, model.step_joint(j, step[6 + j], .35, c.values[j]));
        const double angle = retract(c.base, step.data(), .35);
        if (progress >= 1 && largest < 3e-4 && angle < 3e-4) break;
    }
    orthonormalise(c.base.R);
}

} // namespace pwr
