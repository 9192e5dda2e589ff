#include "tracking.hpp"
#include <chrono>

namespace pwr {

namespace {

constexpr int64_t most_examined = 65536; // points of a cloud that are looked at
constexpr int64_t most_pixels = 131072;  // the same of an image, where most may show nothing
constexpr int candidates_per_point = 4;  // points around the model that are thinned to one
constexpr float reach = .03f;            // a sample nearer to a point is supported, diagonals
constexpr float occluder_gap = .04f;     // what is nearer to the sensor by more than this hides a sample
constexpr float depth_edge = .03f;       // pixels beside one that are farther apart show two surfaces, ...
constexpr float mixed_pixel = .01f;      // ... and one that is so far from either may lie between both
constexpr int judged_samples = 64;       // per part
constexpr int swept_samples = 24;        // per part
constexpr float matched_distance = .02f; // a point nearer to the model is matched in the last iterations
constexpr float close_distance = .05f;   // a point nearer to the model, but not explained, speaks against it
constexpr float at_rest = .1f;           // a point that costs less with parts at rest is not looked up for others
constexpr float sweep_step = .035f;      // what moves farthest moves this far from one value to the next
constexpr int most_swept = 48;           // values to either side
constexpr float sweep_support = .5f;     // weight of the surface that the frame shows, beside that of the points
constexpr float grazing = .1f;           // cosine below which a ray does not tell where it meets the surface
constexpr float least_error = .1f;       // squared, across a surface: of what is 1 along the ray
constexpr int steps_along_ray = 3;       // from the closest sample to where the ray meets the surface
constexpr float finest = .25f;           // of the cell: where there are few points, cells are smaller
constexpr std::array<size_t, 3> strides{1, 2, 4}; // every so many points, in the last iteration, before, and at first
constexpr double settled = .1;                    // variances per variable: a step that gains less ends the iterations
constexpr double independent_share = .5;          // of the points
} // namespace

bool HashedCells::any_within(const Vec *points, Vec p, float reach) const {
    const float limit = reach * reach;
    const int64_t x0 = coordinate(p.x - reach), x1 = coordinate(p.x + reach), y0 = coordinate(p.y - reach),
                  y1 = coordinate(p.y + reach), z0 = coordinate(p.z - reach), z1 = coordinate(p.z + reach);
    for (int64_t x = x0; x <= x1; ++x)
        for (int64_t y = y0; y <= y1; ++y)
            for (int64_t z = z0; z <= z1; ++z) {
                size_t slot;
                for (int i = head_at(x, y, z, slot); i >= 0; i = next[i]) {
                    const Vec d = points[i] - p;
                    if (dot(d, d) <= limit) return true;
                }
            }
    return false;
}

Tracking::Tracking(const Articulated &model, int points, float cell)
    : model(model), most_points(points), cell(cell), T(model.parts), F(model.parts), normal(model.parts),
      twists(6 * model.parts), ranges(range_pixels * range_pixels), thinned(candidates_per_point * points),
      near(points) {
    const size_t size = 6 + model.joints;
    kept.reserve(candidates_per_point * points), sums.reserve(candidates_per_point * points);
    candidates.reserve(most_pixels), close.make_room(points);
    for (int p = 0; p < model.parts; ++p) {
        const Surface &s = model.surface[p];
        if (!s.exists) continue;
        bounds.push_back({p, s.radius, s.centre});
    }
    information.resize(size * size), H.resize(size * size), step.resize(size), off.resize(size);
    reduced.resize(size * size), stopped.resize(model.joints);
    explained.resize(model.parts), strays.resize(model.parts), visible.resize(model.parts), shown.resize(model.parts);
    moved.resize(model.parts), levers.resize(model.joints), moved_weight.resize(model.joints);
    seen_below.resize(model.parts), moved_parts.resize(model.joints);
}

void Tracking::place(const Rigid &base, const double *values) {
    model.forward(base, values, T.data());
    for (int p = 0; p < model.parts; ++p) F[p] = to_float(T[p]);
    for (Bounds &b : bounds) b.centre = apply(F[b.part], model.surface[b.part].centre);
}

void Tracking::expect(const Rigid &base, const double *values, const double *about, double diagonal,
                      const double *origin, float around) {
    std::copy(about, about + 3, centre);
    unit = diagonal, margin = around, has_sensor = origin != nullptr, has_ranges = has_image = false;
    place(base, values);
    low = {1e30f, 1e30f, 1e30f}, high = {-1e30f, -1e30f, -1e30f};
    for (const Bounds &b : bounds) {
        const float r = b.radius + margin;
        const Vec c = b.centre;
        low = {std::min(low.x, c.x - r), std::min(low.y, c.y - r), std::min(low.z, c.z - r)};
        high = {std::max(high.x, c.x + r), std::max(high.y, c.y + r), std::max(high.z, c.z + r)};
    }
    candidates.clear(), kept.clear();
    if (!has_sensor) return;
    sensor = {float((origin[0] - centre[0]) / unit), float((origin[1] - centre[1]) / unit),
              float((origin[2] - centre[2]) / unit)};
    const Vec forward = .5f * (low + high) - sensor;
    const float distance = norm(forward), radius = .5f * norm(high - low);
    if (distance < 1.05f * radius) return; // the sensor is within the model's box: no image holds it
    has_ranges = true;
    half_width = radius / std::sqrt(distance * distance - radius * radius);
    const Vec z = (1 / distance) * forward;
    const Vec aside = std::abs(z.x) < .6f ? Vec{1, 0, 0} : Vec{0, 1, 0};
    Vec x = cross(aside, z);
    x = (1 / norm(x)) * x;
    const Vec y = cross(z, x);
    const float axes[9] = {x.x, x.y, x.z, y.x, y.y, y.z, z.x, z.y, z.z};
    std::copy(axes, axes + 9, view_axes);
    std::fill(ranges.begin(), ranges.end(), std::numeric_limits<float>::infinity());
}

namespace {

// Pixel of a direction seen from the sensor, -1 beside the image.
int pixel_of(const float *axes, float half_width, int pixels, Vec d) {
    const float z = axes[6] * d.x + axes[7] * d.y + axes[8] * d.z;
    if (z <= 0) return -1;
    const float factor = .5f * pixels / (half_width * z);
    const float u = (axes[0] * d.x + axes[1] * d.y + axes[2] * d.z) * factor + .5f * pixels;
    const float v = (axes[3] * d.x + axes[4] * d.y + axes[5] * d.z) * factor + .5f * pixels;
    if (!(u >= 0 && v >= 0 && u < pixels && v < pixels)) return -1;
    return int(v) * pixels + int(u);
}

} // namespace

void Tracking::examine(Vec p) {
    if (has_ranges) {
        const Vec d = p - sensor;
        const int pixel = pixel_of(view_axes, half_width, range_pixels, d);
        if (pixel >= 0) ranges[pixel] = std::min(ranges[pixel], norm(d));
    }
    if (p.x >= low.x && p.y >= low.y && p.z >= low.z && p.x <= high.x && p.y <= high.y && p.z <= high.z)
        candidates.push_back(p);
}

template <typename Number> void Tracking::look(const Number *points, int64_t count) {
    const int64_t stride = (count + most_examined - 1) / most_examined;
    for (int64_t i = 0; i < count; i += stride) {
        const Number *p = points + 3 * i;
        const Vec at{float((p[0] - centre[0]) / unit), float((p[1] - centre[1]) / unit),
                     float((p[2] - centre[2]) / unit)};
        if (std::isfinite(at.x + at.y + at.z)) examine(at);
    }
    settle();
}

template <typename Number> void Tracking::look(const Number *depth, const PinholeView &view) {
    // The pixels that can show the box around the model; all of them where it reaches behind the camera.
    int first_row = 0, last_row = view.height, first_column = 0, last_column = view.width;
    double left = 1e30, right = -1e30, top = 1e30, bottom = -1e30, nearest = 1e30;
    const Rigid back = inverse(view.camera);
    for (int corner = 0; corner < 8; ++corner) {
        const double p[3] = {(corner & 1 ? high.x : low.x) * unit + centre[0],
                             (corner & 2 ? high.y : low.y) * unit + centre[1],
                             (corner & 4 ? high.z : low.z) * unit + centre[2]};
        double c[3];
        for (int i = 0; i < 3; ++i)
            c[i] = back.R[3 * i] * p[0] + back.R[3 * i + 1] * p[1] + back.R[3 * i + 2] * p[2] + back.t[i];
        nearest = std::min(nearest, c[2]);
        const double x = c[0] / c[2], y = c[1] / c[2], u = view.fx * x + view.skew * y + view.cx,
                     v = view.fy * y + view.cy;
        left = std::min(left, u), right = std::max(right, u), top = std::min(top, v), bottom = std::max(bottom, v);
    }
    if (nearest > 1e-3 * unit) {
        first_column = int(std::clamp<double>(std::floor(left), 0, view.width));
        last_column = int(std::clamp<double>(std::ceil(right) + 1, 0, view.width));
        first_row = int(std::clamp<double>(std::floor(top), 0, view.height));
        last_row = int(std::clamp<double>(std::ceil(bottom) + 1, 0, view.height));
    }
    const int64_t pixels = int64_t(last_row - first_row) * (last_column - first_column);
    int stride = 1;
    while (pixels / (int64_t(stride) * stride) > most_pixels) ++stride;
    Rigid in_units = view.camera;
    for (int i = 0; i < 3; ++i) in_units.t[i] = (in_units.t[i] - centre[i]) / unit;
    const RigidF camera = to_float(in_units);
    has_image = true, image = view, image_camera = camera;
    const float scale = float(view.scale / unit), skew = float(view.skew / (view.fx * view.fy));
    auto at = [&](int row, int column) { // 0 where nothing is seen
        if (row < 0 || column < 0 || row >= view.height || column >= view.width) return 0.f;
        const float z = float(depth[int64_t(row) * view.width + column]) * scale;
        return z > 0 && std::isfinite(z) ? z : 0.f;
    };
    // Whether a pixel lies at a depth edge along a row or column, and neither neighbour's surface goes on to it as it
    // slopes.
    auto mixes = [&](float z, int row, int column, int down, int right) {
        const float before = at(row - down, column - right), after = at(row + down, column + right);
        auto jumps = [](float a, float b) { return a > 0 && b > 0 && std::abs(a - b) >= depth_edge; };
        if (!jumps(before, after) && !jumps(before, z) && !jumps(after, z)) return false;
        auto goes_on = [&](float next, float beyond) {
            return next > 0 && beyond > 0 && std::abs(2 * next - beyond - z) < mixed_pixel;
        };
        return !goes_on(before, at(row - 2 * down, column - 2 * right)) &&
               !goes_on(after, at(row + 2 * down, column + 2 * right));
    };
    for (int row = first_row + stride / 2; row < last_row; row += stride)
        for (int column = first_column + stride / 2; column < last_column; column += stride) {
            const float z = at(row, column);
            if (z == 0 || mixes(z, row, column, 0, 1) || mixes(z, row, column, 1, 0)) continue;
            const float x = float((column - view.cx) / view.fx), y = float((row - view.cy) / view.fy);
            examine(apply(camera, {z * (x - skew * float(row - view.cy)), z * y, z}));
        }
    settle();
}

template void Tracking::look(const float *, int64_t);
template void Tracking::look(const double *, int64_t);
template void Tracking::look(const float *, const PinholeView &);
template void Tracking::look(const uint16_t *, const PinholeView &);

// Sum up the points around the model in each cell; false once there are more than `most`.
bool Tracking::thin(float size, int most) {
    const int examined = candidates_per_point * most_points;
    const int stride = (int(candidates.size()) + examined - 1) / examined;
    thinned.clear(size), sums.clear();
    for (size_t i = 0; i < candidates.size(); i += stride) {
        const Vec p = candidates[i];
        const bool close = std::any_of(bounds.begin(), bounds.end(), [&](const Bounds &b) {
            const Vec d = p - b.centre;
            const float r = b.radius + margin;
            return dot(d, d) <= r * r;
        });
        if (!close) continue;
        size_t slot;
        const int at = thinned.head(p, slot);
        if (at >= 0) {
            sums[at].p = sums[at].p + p, sums[at].count += 1;
            continue;
        }
        if (int(sums.size()) == most) return false;
        thinned.put(slot, p, int(sums.size()));
        sums.push_back({p, 1});
    }
    return true;
}

// Thin the points evenly over the surfaces, as little as may be: the mean of each cell, then every so many.
void Tracking::settle() {
    float size = has_sensor ? finest * cell : cell; // closest samples follow the noise that means take away
    while (!thin(size, size < cell ? most_points : candidates_per_point * most_points)) size *= 2;
    for (const Sum &sum : sums) kept.push_back((1 / sum.count) * sum.p);
    if (int(kept.size()) > most_points) {
        for (int i = 0; i < most_points; ++i) kept[i] = kept[size_t(i) * kept.size() / most_points];
        kept.resize(most_points);
    }
    for (size_t level = 0; level < strides.size(); ++level) {
        thinner[level].clear();
        for (size_t i = 0; i < kept.size(); i += strides[level]) thinner[level].push(kept[i]);
    }
    near.clear(reach);
    for (size_t i = 0; i < kept.size(); ++i) {
        size_t slot;
        near.head(kept[i], slot);
        near.put(slot, kept[i], int(i));
    }
}

bool Tracking::faces_sensor(Vec p, Vec n, float cosine) const {
    const Vec view = sensor - p;
    return dot(view, n) > cosine * norm(view);
}

bool Tracking::is_hidden(Vec p) const {
    if (!has_ranges) return false;
    const Vec d = p - sensor;
    const int pixel = pixel_of(view_axes, half_width, range_pixels, d);
    return pixel >= 0 && ranges[pixel] < norm(d) - occluder_gap;
}

bool Tracking::is_beyond_image(Vec p) const {
    if (!has_image) return false;
    const Vec c = apply_inverse(image_camera, p);
    if (c.z <= 0) return true;
    const double x = c.x / c.z, y = c.y / c.z, u = image.fx * x + image.skew * y + image.cx,
                 v = image.fy * y + image.cy;
    return u < 0 || v < 0 || u > image.width - 1 || v > image.height - 1;
}

// Where the ray from the sensor to a point p meets a part near one of its samples: there the surface's normal owes
// nothing to the error of the point, which the closest sample follows. False where it grazes or misses the surface.
bool Tracking::meets(Vec p, int part, int sample, float cap, Vec &foot, Vec &n, float &cosine) const {
    const Surface &s = model.surface[part];
    const RigidF &at = F[part];
    const Vec local = apply_inverse(at, p), from = apply_inverse(at, sensor);
    const Vec way = local - from, ray = (1 / norm(way)) * way;
    Vec x = local;
    for (int step = 0; step <= steps_along_ray; ++step) {
        const int nearest = step ? s.sample_at(x) : sample;
        if (nearest < 0) return false;
        if (step && nearest == sample) break;
        sample = nearest;
        const OrientedPoint &o = s.dense[sample];
        cosine = -dot(ray, o.n);
        if (cosine < grazing) return false;
        const float along = dot(local - o.p, o.n) / cosine;
        if (!(std::abs(along) * cosine < cap)) return false;
        x = local + along * ray;
    }
    const OrientedPoint &o = s.dense[sample];
    const Vec off = x - o.p;
    if (dot(off, off) > 4 * s.slack * s.slack) return false;
    foot = apply(at, x), n = rotate(at, o.n);
    return true;
}

// Find the part nearest to each point, within a cap.
void Tracking::assign(const SplitPoints &points, float cap) {
    distance.assign(points.size + lane_count, cap), owner.assign(points.size, -1), sample.resize(points.size);
    for (const Bounds &b : bounds)
        offer_part(model.surface[b.part], b.part, F[b.part], points, distance.data(), owner.data(), sample.data(),
                   close);
}

TrackingFit Tracking::fit(Rigid &base, double *values, const Rigid &predicted, const double *predicted_values,
                          const double *expected, const uint8_t *held, float sigma_first, float sigma_last, float noise,
                          int iterations, double seconds) {
    const auto start = std::chrono::steady_clock::now();
    const int joints = model.joints, size = 6 + joints;
    TrackingFit result;
    bool all = false;
    // The weights of all points add up to one: this much of it is worth what the prediction is at a deviation of one.
    // Neighbouring points share the sensor's error.
    const double belief = noise * noise / (independent_share * std::max<size_t>(kept.size(), 1));
    for (int iteration = 0; iteration < iterations; ++iteration) {
        if (iteration && std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count() > seconds)
            break;
        // Coarse to fine: few points settle the large motion, more of them the rest, and all of them have the last
        // word.
        const float progress = std::min(1.f, iteration / std::max(2.f, iterations * .3f));
        const float sigma = sigma_first * std::pow(sigma_last / sigma_first, progress), squared = sigma * sigma;
        all |= iteration + 1 == iterations;
        const size_t level = all ? 0 : progress < 1 ? 2 : 1, stride = strides[level];
        const float cap = std::max(3 * sigma + .005f, matched_distance),
                    weight = kept.empty() ? 0.f : float(stride) / kept.size();
        const bool along_rays = has_sensor && progress >= 1;
        int matched = 0;
        double squares = 0;
        place(base, values);
        const Vec about{F[0].t[0], F[0].t[1], F[0].t[2]};
        std::fill(normal.begin(), normal.end(), Normal());
        assign(thinner[level], cap);
        for (size_t at = 0; at < owner.size(); ++at) {
            const size_t i = at * stride;
            const int p = owner[at];
            if (p < 0) continue;
            const float distance = this->distance[at];
            const OrientedPoint &s = model.surface[p].dense[sample[at]];
            Vec n, foot;
            float cosine = 1;
            const bool on_ray = along_rays && meets(kept[i], p, sample[at], cap, foot, n, cosine);
            if (!on_ray) n = rotate(F[p], s.n), foot = apply(F[p], s.p), cosine = 1;
            const Vec offset = kept[i] - foot;
            const float residual = dot(offset, n), kernel = squared / (squared + distance * distance);
            // No sensor sees a surface's back; but a point that stands out beyond it shows where the outline is.
            if (has_sensor && residual < 0 && !faces_sensor(foot, n, -.1f)) continue;
            if (distance < matched_distance) ++matched, squares += double(distance) * distance;
            // The sensor errs along the ray: across a slanted surface, less.
            const float w = weight * kernel * kernel * (1 + least_error) / (cosine * cosine + least_error);
            normal[p].add_plane(foot - about, n, residual, w);
            if (on_ray) continue;
            // Beyond an edge of the surface the distance has a part along the surface too.
            const Vec along = offset - residual * n;
            const float length = norm(along), aside = length - model.surface[p].slack;
            if (aside > 0) normal[p].add_plane(foot - about, (1 / length) * along, aside, w);
        }
        for (int p = 0; p < model.parts; ++p) {
            normal[p].mirror();
            seen_below[p] = normal[p].H[21] + normal[p].H[28] + normal[p].H[35] > 0;
        }
        std::fill(H.begin(), H.end(), 0.), std::fill(step.begin(), step.end(), 0.);
        model.joint_twists(T.data(), T[0].t, twists.data());
        model.compose(normal.data(), twists.data(), H.data(), step.data());
        for (int i = 0; i < 6; ++i) {
            step[i] += normal[0].g[i];
            for (int j = 0; j < 6; ++j) H[i * size + j] += normal[0].H[6 * i + j];
        }
        // Now each part has the equations of all that hangs on it; those of shifts sum up to the weights.
        std::fill(moved_weight.begin(), moved_weight.end(), 0.), std::fill(moved_parts.begin(), moved_parts.end(), 0);
        for (int p = model.parts - 1; p > 0; --p) {
            const double *own = normal[p].H;
            const int j = model.actuated[p], above = model.parent[p];
            seen_below[above] += seen_below[p];
            if (above == 0 || model.actuated[above] != j)
                moved_weight[j] += own[21] + own[28] + own[35], moved_parts[j] += seen_below[p];
        }
        for (int j = 0; j < joints; ++j)
            levers[j] = moved_weight[j] > 0 ? std::sqrt(H[(6 + j) * (size + 1)] * moved_parts[j] / moved_weight[j]) : 0;
        turn_between(base.R, predicted.R, off.data());
        for (int i = 0; i < 3; ++i) off[3 + i] = predicted.t[i] - base.t[i];
        for (int j = 0; j < joints; ++j) {
            off[6 + j] = predicted_values[j] - values[j];
            if (model.wraps[j]) off[6 + j] = std::remainder(off[6 + j], model.upper[j] - model.lower[j]);
        }
        for (int i = 0; i < size; ++i)
            for (int j = 0; j < size; ++j) {
                const double share = belief * expected[i * size + j];
                H[i * size + j] += share, step[i] += share * off[j];
            }
        for (int i = 0; i < size * size; ++i) information[i] = H[i] / belief;
        solve(values, held);
        // What the step gains, in variances of the answer (the squared Newton decrement).
        double gain = 0;
        for (int i = 0; i < size; ++i) gain += right[i] * step[i] / belief;
        for (int j = 0; j < joints; ++j) model.step_joint(j, step[6 + j], .35, values[j]);
        retract(base, step.data(), .35);
        ++result.iterations;
        result.rmse = matched ? float(std::sqrt(squares / matched)) : 0.f;
        if (progress < 1 || gain >= settled * size) continue;
        if (all) break;
        all = true;
    }
    orthonormalise(base.R);
    return result;
}

// Solve H step = step; joints that leave their limits stop there, and the others are solved for again.
void Tracking::solve(const double *values, const uint8_t *held) {
    const int joints = model.joints, size = 6 + joints;
    const auto remainder = [&](int j) {
        return stopped[j] == still ? 0. : (stopped[j] == at_lower ? model.lower[j] : model.upper[j]) - values[j];
    };
    for (int j = 0; j < joints; ++j) stopped[j] = held[j] ? still : 0;
    right = step;
    for (int attempt = 0; attempt < 3; ++attempt) {
        reduced = H, step = right;
        for (int j = 0; j < joints; ++j) {
            if (!stopped[j]) continue;
            const int at = 6 + j;
            const double rest = remainder(j);
            for (int i = 0; i < size; ++i) {
                if (i != at) step[i] -= H[i * size + at] * rest;
                reduced[i * size + at] = reduced[at * size + i] = 0;
            }
            reduced[at * size + at] = 1;
        }
        for (int j = 0; j < joints; ++j)
            if (stopped[j]) step[6 + j] = remainder(j);
        if (!solve_spd(reduced.data(), step.data(), size)) {
            std::fill(step.begin(), step.end(), 0.);
            return;
        }
        bool again = false;
        for (int j = 0; j < joints; ++j) {
            if (stopped[j] || model.wraps[j]) continue;
            const double value = values[j] + step[6 + j];
            if (value < model.lower[j] - 1e-9) stopped[j] = at_lower, again = true;
            if (value > model.upper[j] + 1e-9) stopped[j] = at_upper, again = true;
        }
        if (!again) return;
    }
}

TrackingJudgement Tracking::judge(const Rigid &base, const double *values, float tolerance) {
    place(base, values);
    TrackingJudgement out;
    assign(thinner[1], close_distance); // every other point: shares need no more
    ordered.clear();
    for (size_t i = 0; i < owner.size(); ++i)
        if (owner[i] >= 0) ordered.push_back(distance[i]);
    const auto middle = ordered.begin() + ordered.size() / 2;
    if (middle != ordered.end())
        std::nth_element(ordered.begin(), middle, ordered.end()), out.noise = 1.4826f * *middle;
    if (tolerance <= 0) tolerance = explained_within(out.noise);
    std::fill(explained.begin(), explained.end(), 0.f), std::fill(strays.begin(), strays.end(), 0.f);
    float all = 0, close_by = 0, cost = 0;
    for (size_t i = 0; i < owner.size(); ++i) {
        const int p = owner[i];
        const float squared = distance[i] * distance[i];
        cost += p < 0 ? 1 : squared / (squared + tolerance * tolerance);
        if (p < 0) continue;
        const bool fits = distance[i] < tolerance;
        (fits ? explained : strays)[p] += 1;
        all += fits, close_by += 1;
    }
    out.tolerance = tolerance;
    out.coverage = owner.empty() ? 0 : all / float(owner.size());
    out.cost = owner.empty() ? 1 : cost / float(owner.size());
    out.agreement = close_by > 0 ? all / close_by : 0;
    double total = 0, supported = 0, hidden = 0;
    for (int p = 0; p < model.parts; ++p) {
        const Surface &s = model.surface[p];
        visible[p] = shown[p] = 0;
        if (!s.exists) continue;
        const Seen seen = seen_of(p, judged_samples);
        total += seen.facing, hidden += seen.hidden, supported += seen.shown;
        visible[p] = seen.facing - seen.hidden, shown[p] = seen.shown;
    }
    if (total > 0) {
        out.visible = float(1 - hidden / total);
        if (total > hidden) out.supported = float(supported / (total - hidden));
    }
    return out;
}

Tracking::Seen Tracking::seen_of(int part, int samples) const {
    const Surface &s = model.surface[part];
    const int count = s.count(samples);
    Seen seen;
    for (int i = 0; i < count; ++i) {
        const Vec x = apply(F[part], s.p[i]);
        if (has_sensor && !faces_sensor(x, rotate(F[part], s.n[i]), .2f)) continue;
        const float w = s.weight * s.w[i] / s.cumulated[count];
        seen.facing += w;
        if (near.any_within(kept.data(), x, reach)) seen.shown += w;
        else if (is_hidden(x) || is_beyond_image(x)) seen.hidden += w;
    }
    return seen;
}

// Rigid motion of all parts that a change of the base (rotation about its origin, shift) or of a joint moves.
void Tracking::change(const Rigid &base, const double *values, int variable, double by) {
    if (variable >= 6) {
        swept.assign(values, values + model.joints), swept[variable - 6] += by;
        place(base, swept.data());
        return;
    }
    double step[6] = {};
    step[variable] = by;
    Rigid moved_base = base;
    retract(moved_base, step, 1e9);
    place(moved_base, values);
}

void Tracking::sweep(const Rigid &base, const double *values, int variable, double range, float sigma,
                     std::vector<double> &changes, std::vector<float> &scores) {
    place(base, values);
    float lever = variable < 6 ? 1 : 0, total = 0;
    for (int p = 0; p < model.parts; ++p)
        moved[p] = variable < 6 || (p > 0 && (moved[model.parent[p]] || model.actuated[p] == variable - 6));
    for (const Bounds &b : bounds) {
        total += model.surface[b.part].weight;
        if (variable < 6 || !moved[b.part]) continue;
        int first = b.part; // the joint that moves this part
        while (model.actuated[first] != variable - 6) first = model.parent[first];
        const Vec from{float(T[first].t[0]), float(T[first].t[1]), float(T[first].t[2])};
        const float arm = model.prismatic[first] ? 1.f : norm(b.centre - from) + b.radius;
        lever = std::max(lever, arm * std::abs(float(model.multiplier[first])));
    }
    changes.assign(1, 0), scores.clear();
    if (lever <= 0) {
        scores.push_back(0);
        return;
    }
    const double step = std::max(double(sweep_step / lever), range / most_swept);
    for (int i = 1; i <= int(range / step); ++i) changes.push_back(-i * step), changes.push_back(i * step);
    if (variable >= 6 && !model.wraps[variable - 6]) {
        const double value = values[variable - 6], low = model.lower[variable - 6], high = model.upper[variable - 6];
        const auto beyond = [&](double by) { return by != 0 && (value + by < low || value + by > high); };
        changes.erase(std::remove_if(changes.begin(), changes.end(), beyond), changes.end());
    }
    // Those parts that stay are looked up once.
    const SplitPoints &points = thinner[1];
    const float squared = sigma * sigma;
    distance.assign(points.size + lane_count, close_distance), owner.assign(points.size, -1),
        sample.resize(points.size);
    for (const Bounds &b : bounds)
        if (!moved[b.part])
            offer_part(model.surface[b.part], b.part, F[b.part], points, distance.data(), owner.data(), sample.data(),
                       close);
    resting.assign(distance.begin(), distance.end());
    for (const double by : changes) {
        change(base, values, variable, by);
        std::copy(resting.begin(), resting.end(), distance.begin());
        float surface = 0;
        for (const Bounds &b : bounds) {
            if (!moved[b.part]) continue;
            offer_part(model.surface[b.part], b.part, F[b.part], points, distance.data(), owner.data(), sample.data(),
                       close);
            const Seen seen = seen_of(b.part, swept_samples);
            surface += 2 * seen.shown - (seen.facing - seen.hidden);
        }
        double fits = 0;
        for (int64_t i = 0; i < points.size; ++i)
            if (distance[i] < close_distance) fits += squared / (squared + distance[i] * distance[i]);
        scores.push_back(float(fits / std::max<int64_t>(points.size, 1)) + sweep_support * surface / total);
    }
}

void Tracking::weigh(const Rigid &base, const double *values, int64_t count, const uint8_t *varied, float tolerance,
                     float *against) {
    if (count == 0) return;
    const float squared = tolerance * tolerance;
    const auto cost_at = [&](float d) { return d < close_distance ? d * d / (d * d + squared) : 1.f; };
    for (int p = 0; p < model.parts; ++p)
        moved[p] = p > 0 && (moved[model.parent[p]] || (model.actuated[p] >= 0 && varied[model.actuated[p]]));
    place(base, values);
    const SplitPoints &points = thinner[1];
    distance.assign(points.size + lane_count, close_distance), owner.assign(points.size, -1),
        sample.resize(points.size);
    Seen resting_surface;
    for (const Bounds &b : bounds) {
        if (moved[b.part]) continue;
        offer_part(model.surface[b.part], b.part, F[b.part], points, distance.data(), owner.data(), sample.data(),
                   close);
        resting_surface.add(seen_of(b.part, judged_samples));
    }
    float settled_cost = 0;
    resting.clear(), loose.clear();
    for (int64_t i = 0; i < points.size; ++i) {
        const float own = cost_at(distance[i]);
        if (own < at_rest) settled_cost += own;
        else resting.push_back(distance[i]), loose.push({points.x[i], points.y[i], points.z[i]});
    }
    resting.resize(resting.size() + lane_count, close_distance);
    for (int64_t row = 0; row < count; ++row) {
        place(base, values + row * model.joints);
        std::copy(resting.begin(), resting.end(), distance.begin());
        Seen surface = resting_surface;
        for (const Bounds &b : bounds) {
            if (!moved[b.part]) continue;
            offer_part(model.surface[b.part], b.part, F[b.part], loose, distance.data(), owner.data(), sample.data(),
                       close);
            surface.add(seen_of(b.part, judged_samples));
        }
        float cost = settled_cost;
        for (int64_t i = 0; i < loose.size; ++i) cost += cost_at(distance[i]);
        const float visible = surface.facing - surface.hidden;
        against[row] = cost / std::max<int64_t>(points.size, 1) + 1 - (visible > 0 ? surface.shown / visible : 0);
    }
}

} // namespace pwr
